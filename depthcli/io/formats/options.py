"""Options of the output formats, each stated once; free of numpy, so that help texts can list them.

A field is an option: its name, type, default, help and range. The command line, the query of
``serve``, profiles and ``DepthMap.save`` derive from these classes; the first line of a class's
docstring is the heading of its options in the help.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from depthcli.core.options import MILLIMETRES, Colormap, Near, Rule, StereoLayout, chosen
from depthcli.errors import UsageError

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
        if self.vmin != self.vmin or self.vmax != self.vmax:
            raise UsageError("vmin and vmax have to be numbers, not nan")
        if self.vmin is not None and self.vmax is not None and self.vmin > self.vmax:
            raise UsageError(f"vmin {self.vmin:g} is above vmax {self.vmax:g}; swap them")
        if self.stride is not None and not _STRIDE.holds(self.stride):
            raise UsageError(f"a stride of {self.stride} is not {_STRIDE.what}", option="stride")


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
