"""The table of output formats, and their options; free of numpy, so that help texts can list them.

A format is a file in this folder and a line in :class:`Format`. Its file has a class that writes,
and a function ``read`` if ``info`` and ``convert`` read it back.

A field of the classes of options is one: its name, type, default, help and range. The command line,
the query of ``serve``, profiles and ``DepthMap.save`` derive from them; the first line of a class's
docstring is the heading of its options in the help.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import StrEnum
from functools import partial
from pathlib import PurePath
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, Self

from depthcli.core.options import MILLIMETRES, Colormap, Near, Rule, StereoLayout, chosen
from depthcli.errors import UsageError
from depthcli.io.media import EXR_MARK, KEY_PREFIX, SOFTWARE_KEY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    from depthcli.core.types import DepthMap, Frame
    from depthcli.io.stored.depth import DepthReadOptions, StoredDepth

EYE_DISTANCE_M = 0.063  #: mean distance of adults' eyes
HELP = "help"
"""Key of a field's metadata with its help; beside it are ``rule`` and ``is_usual``."""
_LARGEST = 1e9
_ENUMERATIONS = {"colormap": Colormap, "near": Near, "stereo_layout": StereoLayout}

EYE_DISTANCE = Rule("in metres, above 0 and at most 5", lambda m: 0 < m <= 5)  # noqa: PLR2004
POSITIVE = Rule("greater than 0", lambda x: 0 < x < float("inf"))
PNG_SCALE = Rule("from 0.001 to 1000000", lambda x: 1e-3 <= x <= 1e6)  # noqa: PLR2004
_FINITE = Rule("a number up to 1e9", lambda x: abs(x) <= _LARGEST)
_STRIDE = Rule("1 or more", lambda n: n >= 1)


def _option(
    text: str,
    default: Any = None,  # noqa: ANN401 - of the field's type
    rule: Rule | None = None,
    *,
    is_usual: bool = False,
) -> Any:  # noqa: ANN401
    """A field with its help, the rule of its values, and whether it is among the usual ones."""
    return field(default=default, metadata={HELP: text, "rule": rule, "is_usual": is_usual})


@dataclass(frozen=True, kw_only=True)
class PngOptions:
    """16-bit PNG."""

    png_scale: float | None = _option(
        "PNG units per metre: 1000 (default, millimetres), 256 (KITTI), 5000 (TUM), "
        "4000 (Matterport).",
        rule=PNG_SCALE,
    )
    png_normalize: bool = _option(
        "Normalize each png16 to 1-65535; the depth range is stored in its metadata.", default=False
    )
    png_inverse: bool = _option(
        "Normalize 1/depth in each png16 instead, so that near is white: for compositors, "
        "ControlNet and Gaussian splatting.",
        default=False,
    )

    @property
    def units_per_metre(self) -> float:
        """Units per metre in 16-bit depth that is not normalized."""
        return self.png_scale or MILLIMETRES

    @property
    def is_normalized(self) -> bool:
        """Whether 16-bit PNG is normalized."""
        return self.png_normalize or self.png_inverse


@dataclass(frozen=True, kw_only=True)
class ExrOptions:
    """EXR."""

    exr_channel: Literal["Z", "Y", "R", "depth.Z"] = _option(
        "EXR channel name: most programs show Y; depth nodes of compositors expect Z or depth.Z.",
        default="Y",
    )
    half: bool = _option("Write EXR as 16-bit half floats.", default=False)


@dataclass(frozen=True, kw_only=True)
class PreviewOptions:
    """Preview."""

    colormap: Colormap | None = _option(
        "Colormap of the preview. Default: inferno, or gray with --near white or black.",
        is_usual=True,
    )
    near: Near | None = _option(
        "Colour of near depth: warm, or white or black with gray. Default: warm, or white "
        "with gray."
    )
    legend: bool = _option("Draw a colour scale beside the preview.", default=False)
    side_by_side: bool = _option("Show the input image beside the preview.", default=False)

    @property
    def palette(self) -> tuple[Colormap, Near]:
        """Colormap and near colour; a white or black one is that of gray."""
        near = self.near or Near.WARM
        usual = Colormap.INFERNO if near is Near.WARM else Colormap.GRAY
        return self.colormap or usual, near


@dataclass(frozen=True, kw_only=True)
class RangeOptions:
    """Preview."""

    vmin: float | None = _option(
        "Lower end of the depth range of previews and normalized png16 (and mkv), in metres if "
        "metric. Default: 2nd percentile; for png16, the minimum.",
        rule=_FINITE,
    )
    vmax: float | None = _option(
        "Upper end of the depth range of previews and normalized png16 (and mkv), in metres if "
        "metric. Default: 98th percentile; for png16, the maximum.",
        rule=_FINITE,
    )

    def range_of(self, spread: tuple[float, float]) -> tuple[float, float]:
        """Low and high end of a range, where ``vmin`` and ``vmax`` replace those of a map."""
        low = spread[0] if self.vmin is None else self.vmin
        high = spread[1] if self.vmax is None else self.vmax
        # The map's end gives way to one that is given.
        return (min(low, high), high) if self.vmin is None else (low, max(low, high))


@dataclass(frozen=True, kw_only=True)
class SurfaceOptions:
    """Points and meshes."""

    stride: int | None = _option(
        "Use only every N-th pixel of every N-th row. Default: 1, but html is thinned to about "
        "640x480 points.",
        rule=_STRIDE,
    )
    max_depth_m: float | None = _option("Leave out what is farther, in metres.", rule=POSITIVE)
    max_error: float | None = _option(
        "Leave out what has a larger expected error, as a share of depth: 0.15.", rule=POSITIVE
    )
    keep_edges: bool = _option(
        "Keep pixels and triangles at edges, which are smeared between near and far.", default=False
    )


@dataclass(frozen=True, kw_only=True)
class PlyOptions:
    """Points and meshes."""

    faces: bool = _option("Write triangles into PLY, not only points.", default=False)


@dataclass(frozen=True, kw_only=True)
class StereoOptions:
    """Stereo pair."""

    stereo_layout: StereoLayout = _option(
        "Views side by side or one above the other, squeezed to one image (half), or as an "
        "anaglyph for red and cyan glasses.",
        default=StereoLayout.SIDE_BY_SIDE,
    )
    eye_distance_m: float = _option(
        "Distance between the eyes in metres; larger is deeper.",
        default=EYE_DISTANCE_M,
        rule=EYE_DISTANCE,
    )
    convergence_m: float | None = _option(
        "Depth that appears at the screen; nearer is in front of it. Default: the nearest.",
        rule=POSITIVE,
    )


@dataclass(frozen=True, kw_only=True)
class WriterOptions(
    PngOptions, ExrOptions, PreviewOptions, RangeOptions, SurfaceOptions, PlyOptions, StereoOptions
):
    """Options of all formats; the table of formats states which of them each writer uses."""

    def __post_init__(self) -> None:
        for each in fields(self):
            rule, value = each.metadata["rule"], getattr(self, each.name)
            if rule and value is not None and not rule.holds(value):
                raise UsageError(f"{value} is not {rule.what}", option=each.name)
        if self.vmin is not None and self.vmax is not None and self.vmin > self.vmax:
            raise UsageError(f"vmin {self.vmin:g} is above vmax {self.vmax:g}; swap them")


def names_of(*groups: type) -> tuple[str, ...]:
    """Names of the options of some classes, in their order."""
    return tuple(each.name for group in groups for each in fields(group))


def with_members(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options with members of enumerations in place of their words, without None.

    UsageError if a word is of no member.
    """
    chosen_ = {name: value for name, value in options.items() if value is not None}
    words = {name: kind for name, kind in _ENUMERATIONS.items() if name in chosen_}
    return chosen_ | {name: chosen(kind, chosen_[name], name) for name, kind in words.items()}


class Writer(Protocol):
    """One output format with its options; its name and suffix are in the table of formats."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write a depth map.

        Args:
            depth: the map.
            path: the file, written in place; callers make it atomic.
            frame: the image it belongs to, for formats that show it.

        Returns:
            Warnings, one line each.

        Raises:
            OSError: the file cannot be written.
            OutputError: the map cannot be expressed in this format.
        """


class FormatFacts(NamedTuple):
    """The entry of a format in the table, known without loading its file."""

    #: its class, as ``module:name``; loaded when the format is used, because OpenEXR takes start-up
    #: time
    writer: str
    suffix: str  #: end of the default output name, after the input's stem
    #: file suffix that chooses this format where the user names a file; None if only ``suffix``
    #: does
    file_suffix: str | None
    #: bytes within the first 4,096 of every file that depthcli writes; empty if the format has no
    #: room for any, and only a default name tells whose a file is
    mark: bytes = b""
    options: tuple[str, ...] = ()  #: fields of :class:`WriterOptions` that its class has, too
    range_options: tuple[str, ...] = ()  #: further ones, which only normalized integers have
    shows_image: bool = False  #: whether its files show the image
    has_overscan: bool = False  #: whether its files have the pixels outside the display window
    has_camera: bool = False  #: whether its files depend on the camera of the map or state it
    #: whether its module has a function ``read``; a video is written to numbered files in it then
    is_readable: bool = False
    is_exact: bool = False  #: whether it stores the values bit for bit

    def fields(self, *, is_normalized: bool) -> tuple[str, ...]:
        """Fields of :class:`WriterOptions` that have an effect."""
        return self.options + self.range_options if is_normalized else self.options


_ALIASES = {".tif": ".tiff"}  # other suffixes of files, and those that they stand for


def suffix_of(path: str | PurePath) -> str:
    """The suffix of a file in lower case; ``.tiff`` for ``.tif``."""
    suffix = PurePath(path).suffix.lower()
    return _ALIASES.get(suffix, suffix)


_COLOURS = names_of(PreviewOptions, RangeOptions)
_EXR, _PNG, _ENDS = names_of(ExrOptions), names_of(PngOptions), names_of(RangeOptions)
_SURFACE, _STEREO = names_of(SurfaceOptions), names_of(StereoOptions)
_PLY = names_of(SurfaceOptions, PlyOptions)
_PNG_MARK = f"{SOFTWARE_KEY}\0".encode()
_PGM_MARK = f"# {SOFTWARE_KEY} ".encode()
_PLY_MARK = f"comment {KEY_PREFIX}".encode()
_HTML_MARK = b'name="generator" content="depthcli '
_JSON_MARK = b'"software": "depthcli '
_image = partial(FormatFacts, shows_image=True)
_stated = partial(FormatFacts, has_camera=True)
_scene = partial(_stated, shows_image=True)
_plate = partial(_stated, has_overscan=True, options=("half",))
_readable = partial(_stated, is_readable=True)
_steps = partial(_readable, options=_PNG, range_options=_ENDS)
_exact = partial(_readable, is_exact=True)
_floats = partial(FormatFacts, "raster:FloatWriter", is_readable=True, is_exact=True)


class TableOfFormats(StrEnum):
    """Formats, whose members are their word and their facts."""

    facts: Any

    def __new__(cls, word: str, *facts: Any) -> Self:  # noqa: ANN401, D102 - Format("exr") is typed
        member = str.__new__(cls, word)
        member._value_ = word
        (member.facts,) = facts
        return member


class Format(TableOfFormats):
    """Output formats of an image's depth, the values of ``--format``; a new one is a line here."""

    facts: FormatFacts

    PNG16 = "png16", _steps("raster:Png16Writer", ".depth.png", ".png", _PNG_MARK)
    EXR = "exr", _exact("exr:ExrWriter", ".depth.exr", ".exr", EXR_MARK, _EXR, has_overscan=True)
    NPY = "npy", _floats(".depth.npy", ".npy")
    PREVIEW = "preview", _image("preview:PreviewWriter", ".preview.png", None, _PNG_MARK, _COLOURS)
    PLY = "ply", _scene("geometry:PlyWriter", ".ply", ".ply", _PLY_MARK, _PLY)
    GLB = "glb", _scene("geometry:GlbWriter", ".glb", ".glb", b'"generator":"depthcli ', _SURFACE)
    USDZ = "usdz", _scene("usdz:UsdzWriter", ".usdz", ".usdz", b"depthcli.usdc", _SURFACE)
    HTML = "html", _scene("views:HtmlWriter", ".html", ".html", _HTML_MARK, _SURFACE)
    NORMALS = "normals", _stated("geometry:NormalsWriter", ".normals.png", None, _PNG_MARK)
    NORMALS_EXR = "normals-exr", _plate("exr:NormalsExrWriter", ".normals.exr", None, EXR_MARK)
    ERROR = "error", FormatFacts("raster:ErrorWriter", ".error.png", None, _PNG_MARK)
    STEREO = "stereo", _scene("views:StereoWriter", ".stereo.png", None, _PNG_MARK, _STEREO)
    PFM = "pfm", _floats(".depth.pfm", ".pfm")
    TIFF = "tiff", _floats(".depth.tiff", ".tiff")
    PGM = "pgm", _steps("raster:Png16Writer", ".depth.pgm", ".pgm", _PGM_MARK)
    NPZ = "npz", _exact("raster:NpzWriter", ".depth.npz", ".npz", b"depthcli.npy")
    COLMAP = "colmap", _floats(".depth.bin", ".bin")
    JSON = "json", _stated("raster:SidecarWriter", ".depth.json", ".json", _JSON_MARK, _PNG, _ENDS)


FORMATS = {format_: format_.facts for format_ in Format}
FILE_SUFFIXES = tuple(facts.file_suffix for facts in FORMATS.values() if facts.file_suffix)
"""File suffixes that choose a format."""
READABLE = sorted(
    (name for name in Format if name.facts.is_readable),
    key=lambda name: (not name.facts.is_exact, name is not Format.NPY),
)
"""The formats that are read back, the exact ones first; EXR may be of half floats."""
READABLE_SUFFIXES = (*(str(f.facts.file_suffix) for f in Format if f.facts.is_readable), *_ALIASES)
"""File suffixes of the formats that are read back."""


def format_of(path: str | PurePath) -> Format | None:
    """The format that a file's name chooses; None if it chooses none.

    Default names of outputs come first: ``a.preview.png`` is a preview, ``a.png`` is 16-bit depth.
    """
    name = PurePath(path).name.lower()
    for format_, facts in FORMATS.items():
        if name.endswith(facts.suffix):
            return format_
    suffix = suffix_of(name)
    return next((f for f, facts in FORMATS.items() if facts.file_suffix == suffix), None)


def stem_of(path: str | PurePath, others: Iterable[str] = ()) -> str:
    """A file's name without the suffix of its format: ``a`` of ``a.png`` and ``a.preview.png``.

    What selects no format is part of the name: ``1305031102.16`` is its own stem. ``others`` are
    suffixes of further formats, longer ones first.
    """
    name = PurePath(path).name
    ends = (*others, *(facts.suffix for facts in FORMATS.values()), *FILE_SUFFIXES, *_ALIASES)
    end = next((end for end in ends if name.lower().endswith(end)), "")
    return name[: len(name) - len(end)] or name


def reader_of(path: Path) -> Callable[[Path, DepthReadOptions], StoredDepth] | None:
    """The function ``read`` of a depth file's format, by its suffix; None if it is not read."""
    format_ = format_of(PurePath(f"a{path.suffix}"))
    if format_ is None or not format_.facts.is_readable:
        return None
    module = format_.facts.writer.partition(":")[0]
    read: Callable[[Path, DepthReadOptions], StoredDepth]
    read = resolve_name(f"depthcli.io.formats.{module}:read")
    return read


def writer_class(name: Format) -> type[Writer]:
    """The writer of a format; its module is loaded now."""
    writer: type[Writer] = resolve_name(f"depthcli.io.formats.{FORMATS[name].writer}")
    return writer


def writer_of(name: Format, options: WriterOptions) -> Writer:
    """The writer of a format with the options that it uses; its module is loaded now."""
    used = FORMATS[name].fields(is_normalized=options.is_normalized)
    return writer_class(name)(**{option: getattr(options, option) for option in used})
