"""The table of output formats; free of numpy, so that help texts can list it."""

from collections.abc import Iterable
from enum import StrEnum
from pathlib import PurePath
from pkgutil import resolve_name
from typing import NamedTuple, Self

from depthcli.io.formats.base import Writer

MILLIMETRES = 1000.0
"""Default units per metre of 16-bit depth."""


class FormatFacts(NamedTuple):
    """The entry of a format in the table, known without loading its writer."""

    #: its class, as ``module:name``; loaded when the format is used, because OpenEXR takes start-up
    #: time
    writer: str
    suffix: str  #: end of the default output name, after the input's stem
    #: file suffix that chooses this format where the user names a file; None if only ``suffix``
    #: does
    file_suffix: str | None
    #: fields of :class:`~depthcli.io.formats.options.WriterOptions` that the writer has, too
    options: tuple[str, ...] = ()
    has_overscan: bool = False  #: whether its files have the pixels outside the display window
    has_camera: bool = False  #: whether its files depend on the camera of the map or state it

    @property
    def parameters(self) -> tuple[str, ...]:
        """Parameters of the commands that it uses besides those of all formats."""
        return (*self.options, "centre_px") if self.has_camera else self.options


_COLOURS = ("colormap", "near", "vmin", "vmax", "legend", "side_by_side")
_EXR = ("exr_channel", "half")
_PNG = ("png_scale", "png_normalize")


class Format(StrEnum):
    """Output formats of a picture's depth; the values of ``--format``.

    A member is its name and its :class:`FormatFacts`; a new one needs no change elsewhere.
    """

    facts: FormatFacts

    def __new__(cls, word: str, *facts: FormatFacts) -> Self:  # noqa: D102 - Format("exr") is typed
        member = str.__new__(cls, word)
        member._value_ = word
        (member.facts,) = facts
        return member

    PNG16 = (
        "png16",
        FormatFacts("png16:Png16Writer", ".depth.png", ".png", _PNG, has_camera=True),
    )
    EXR = (
        "exr",
        FormatFacts(
            "exr:ExrWriter", ".depth.exr", ".exr", _EXR, has_overscan=True, has_camera=True
        ),
    )
    NPY = "npy", FormatFacts("npy:NpyWriter", ".depth.npy", ".npy")
    PREVIEW = (
        "preview",
        FormatFacts("preview:PreviewWriter", ".preview.png", None, _COLOURS),
    )
    PLY = "ply", FormatFacts("ply:PlyWriter", ".ply", ".ply", has_camera=True)
    # It describes the PNG beside it.
    JSON = (
        "json",
        FormatFacts("sidecar:SidecarWriter", ".depth.json", ".json", _PNG, has_camera=True),
    )


FORMATS = {format_: format_.facts for format_ in Format}
FILE_SUFFIXES = tuple(facts.file_suffix for facts in FORMATS.values() if facts.file_suffix)
"""File suffixes that choose a format."""


def format_of(path: str | PurePath) -> Format | None:
    """The format that a file's name chooses; None if it chooses none.

    Default names of outputs come first: ``a.preview.png`` is a preview, ``a.png`` is 16-bit depth.
    """
    name = PurePath(path).name.lower()
    for format_, facts in FORMATS.items():
        if name.endswith(facts.suffix):
            return format_
    suffix = PurePath(name).suffix
    return next((f for f, facts in FORMATS.items() if facts.file_suffix == suffix), None)


def fits(path: str | PurePath, asked: Format) -> bool:
    """Whether a file of this name can have a format: ``a.png`` can be a preview, too."""
    return format_of(path) is None or PurePath(path).suffix.lower() == file_suffix_of(asked)


def file_suffix_of(asked: Format) -> str:
    """The file suffix of a format: ``.png`` of ``.depth.png``."""
    return PurePath(f"a{asked.facts.suffix}").suffix


def stem_of(path: str | PurePath, others: Iterable[str] = ()) -> str:
    """A file's name without the suffix of its format: ``a`` of ``a.png`` and ``a.preview.png``.

    What selects no format is part of the name: ``1305031102.16`` is its own stem. ``others`` are
    suffixes of further formats, longer ones first.
    """
    name = PurePath(path).name
    ends = (*others, *(facts.suffix for facts in FORMATS.values()), *FILE_SUFFIXES)
    end = next((end for end in ends if name.lower().endswith(end)), "")
    return name[: len(name) - len(end)] or name


def writer_class(name: Format) -> type[Writer]:
    """The writer of a format."""
    found: type[Writer] = resolve_name(f"depthcli.io.formats.{FORMATS[name].writer}")
    return found
