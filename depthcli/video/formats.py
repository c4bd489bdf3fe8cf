"""The table of formats for a video's depth; free of numpy, so that help texts can list it."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import PurePath
from typing import Self

from depthcli.io.formats.table import FORMATS, Format, stem_of

FRAME_NUMBER = "%06d"
"""Placeholder of the frame's number in the name of a sequence."""


@dataclass(frozen=True, slots=True)
class VideoFormatFacts:
    """The entry of a format in the table, known without loading its writer."""

    suffix: str  #: end of the default output name; of a sequence, with ``FRAME_NUMBER``
    #: file suffix that chooses this format where the user names a file; None if none does
    file_suffix: str | None
    #: the format of pictures whose writer writes its frames; None if there is none
    picture: Format | None
    #: the format of pictures that this replaces for videos in a batch; None if it replaces none
    counterpart: Format | None
    #: options of the command that it uses, by the names of their parameters
    options: tuple[str, ...]

    @property
    def is_sequence(self) -> bool:
        """Whether it is a file for each frame."""
        return FRAME_NUMBER in self.suffix

    @property
    def is_preview(self) -> bool:
        """Whether it is a video of previews."""
        return self.picture is Format.PREVIEW


def _preview(file_suffix: str, counterpart: Format | None = None) -> VideoFormatFacts:
    options = (*FORMATS[Format.PREVIEW].options, "lock", "codec", "audio")
    suffix = f".preview{file_suffix}"
    return VideoFormatFacts(suffix, file_suffix, Format.PREVIEW, counterpart, options)


def _frames(picture: Format, *, is_counterpart: bool = True) -> VideoFormatFacts:
    facts = FORMATS[picture]
    suffix = f".depth.{FRAME_NUMBER}{facts.file_suffix}"
    counterpart = picture if is_counterpart else None
    return VideoFormatFacts(suffix, None, picture, counterpart, facts.parameters)


class VideoFormat(StrEnum):
    """Output formats of a video's depth; the values of ``--format``.

    A member is its name and its :class:`VideoFormatFacts`.
    """

    facts: VideoFormatFacts

    def __new__(cls, word: str, *facts: VideoFormatFacts) -> Self:  # noqa: D102 - as Format
        member = str.__new__(cls, word)
        member._value_ = word
        (member.facts,) = facts
        return member

    # Lossless 16-bit video.
    MKV = (
        "mkv",
        VideoFormatFacts(
            ".depth.mkv",
            ".mkv",
            None,
            Format.PNG16,
            ("png_scale", "centre_px", "lock", "vmin", "vmax"),
        ),
    )
    MP4 = "mp4", _preview(".mp4", Format.PREVIEW)
    WEBM = "webm", _preview(".webm")
    MOV = "mov", _preview(".mov")
    PNG16 = "png16", _frames(Format.PNG16, is_counterpart=False)
    EXR = "exr", _frames(Format.EXR)
    NPY = "npy", _frames(Format.NPY)
    # What the numbers of the others mean.
    JSON = (
        "json",
        VideoFormatFacts(".depth.json", ".json", None, Format.JSON, Format.JSON.facts.parameters),
    )


VIDEO_FORMATS = {which: which.facts for which in VideoFormat}
SEQUENCES = tuple(which for which, facts in VIDEO_FORMATS.items() if facts.is_sequence)
COUNTERPARTS = {
    facts.counterpart: which for which, facts in VIDEO_FORMATS.items() if facts.counterpart
}
"""The format that a batch writes for videos, by the format it writes for pictures."""


def video_format_of(path: str | PurePath) -> VideoFormat | None:
    """The format of a whole video that a file's suffix chooses; None if it chooses none."""
    suffix = PurePath(path).suffix.lower()
    return next((which for which, f in VIDEO_FORMATS.items() if f.file_suffix == suffix), None)


def sequence_of(path: str | PurePath) -> VideoFormat | None:
    """The format that the suffix of numbered files chooses; None if it chooses none."""
    suffix = PurePath(path).suffix.lower()
    return next((w for w in SEQUENCES if VIDEO_FORMATS[w].suffix.endswith(suffix or "\0")), None)


def frame_suffix(which: VideoFormat) -> str:
    """The suffix of numbered files: ``.exr`` of ``.depth.%06d.exr``."""
    return PurePath(f"a{VIDEO_FORMATS[which].suffix}").suffix


def video_stem_of(path: str | PurePath) -> str:
    """A file's name without the suffix of its format: ``a`` of ``a.mkv`` and ``a.preview.mp4``.

    What selects no format is part of the name: ``shot.v003`` is its own stem.
    """
    whole = [facts.suffix for facts in VIDEO_FORMATS.values() if facts.file_suffix]
    short = [facts.file_suffix for facts in VIDEO_FORMATS.values() if facts.file_suffix]
    return stem_of(path, (*whole, *short))
