"""The table of output formats; free of numpy, so that help texts can list it."""

from enum import StrEnum
from importlib import import_module
from pathlib import PurePath
from typing import NamedTuple, Self

from depthcli.io.writers.base import Writer

MILLIMETRES = 1000.0
"""Steps per metre of 16-bit depth, where nothing else is said."""


class FormatFacts(NamedTuple):
    """What is known of a format before anything of it is loaded."""

    #: its class, as ``module:name``. Modules are loaded when a format is used: OpenEXR costs start-
    #: up time that PNG need not pay
    writer: str
    suffix: str  #: end of the default output name, after the input's stem
    #: file suffix that chooses this format where the user names a file; None if only ``suffix``
    #: does
    ending: str | None
    #: those of :class:`~depthcli.io.writers.options.WriterOptions` that the writer has, under the
    #: same names
    options: tuple[str, ...] = ()
    #: memory of writing it, bytes a pixel beside picture and depth, measured with some to spare
    use_bytes: int = 10


_COLOURS = ("colormap", "near", "vmin", "vmax", "legend", "side_by_side")
_PNG = ("png_scale", "png_normalize")


class Format(StrEnum):
    """What is written of a picture; ``--format`` takes these words.

    A member is its word and its :class:`FormatFacts`; nothing else need know of a new one.
    """

    facts: FormatFacts

    def __new__(cls, word: str, *facts: FormatFacts) -> Self:  # noqa: D102 - Format("exr") is typed
        member = str.__new__(cls, word)
        member._value_ = word
        (member.facts,) = facts
        return member

    PNG16 = "png16", FormatFacts("png16:Png16Writer", ".depth.png", ".png", _PNG, use_bytes=13)
    EXR = "exr", FormatFacts("exr:ExrWriter", ".depth.exr", ".exr", ("exr_channel", "half"))
    NPY = "npy", FormatFacts("npy:NpyWriter", ".depth.npy", ".npy")
    PREVIEW = (
        "preview",
        FormatFacts("preview:PreviewWriter", ".preview.png", None, _COLOURS, use_bytes=20),
    )
    PLY = "ply", FormatFacts("ply:PlyWriter", ".ply", ".ply", ("centre_px",), use_bytes=46)
    # It describes the PNG beside it.
    JSON = "json", FormatFacts("sidecar:SidecarWriter", ".depth.json", ".json", _PNG)


FORMATS = {format_: format_.facts for format_ in Format}
ENDINGS = tuple(facts.ending for facts in FORMATS.values() if facts.ending)
"""File suffixes that say a format."""


def format_of(path: str | PurePath) -> Format | None:
    """The format that a file's name says; None if it says none.

    The names that depthcli itself gives count whole: ``a.preview.png`` is a preview, ``a.png`` is
    16-bit depth.
    """
    name = PurePath(path).name.lower()
    for format_, facts in FORMATS.items():
        if name.endswith(facts.suffix):
            return format_
    suffix = PurePath(name).suffix
    return next((f for f, facts in FORMATS.items() if facts.ending == suffix), None)


def fits(path: str | PurePath, asked: Format) -> bool:
    """Whether a file's name says the same format, or none: ``a.png`` fits a preview, too."""
    return format_of(path) is None or PurePath(path).suffix.lower() == ending_of(asked)


def ending_of(asked: Format) -> str:
    """The file suffix of a format: ``.png`` of ``.depth.png``."""
    return PurePath(f"a{asked.facts.suffix}").suffix


def stem_of(path: str | PurePath) -> str:
    """A file's name without what says its format: ``a`` of ``a.png`` and of ``a.preview.png``."""
    name = PurePath(path).name
    ends = (facts.suffix for facts in FORMATS.values() if name.lower().endswith(facts.suffix))
    end = next(ends, PurePath(name).suffix)
    return name[: len(name) - len(end)] or name


def writer_class(name: Format) -> type[Writer]:
    """The class of a format."""
    module, _, attribute = FORMATS[name].writer.partition(":")
    found: type[Writer] = getattr(import_module(f"depthcli.io.writers.{module}"), attribute)
    return found
