"""The table of formats for a video's depth; free of numpy, so that help texts can list it."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import PurePath
from typing import Self

from depthcli.io.writers.formats import FORMATS, Format

FRAME_NUMBER = "%06d"
"""Place of the frame's number in the name of a file for each frame."""


@dataclass(frozen=True, slots=True)
class VideoFormatFacts:
    """What is known of a format before anything of it is loaded."""

    suffix: str  #: end of the default output name; of a file for each frame, with ``FRAME_NUMBER``
    #: file suffix that chooses this format where the user names a file; None if none does
    ending: str | None
    #: the format of pictures whose writer makes its frames; None if it has none
    picture: Format | None
    #: the format of pictures in whose place a batch writes this; None if it does not
    counterpart: Format | None
    #: options of the command that it uses, by the names of their parameters
    options: tuple[str, ...]
    use_bytes: int  #: memory of writing it, as for pictures

    @property
    def is_sequence(self) -> bool:
        """Whether it is a file for each frame."""
        return FRAME_NUMBER in self.suffix

    @property
    def is_preview(self) -> bool:
        """Whether it is a video of previews."""
        return self.picture is Format.PREVIEW


def _preview(
    ending: str, counterpart: Format | None = None, *, use_bytes: int = 20
) -> VideoFormatFacts:
    options = (*FORMATS[Format.PREVIEW].options, "lock", "codec", "audio")
    suffix = f".preview{ending}"
    return VideoFormatFacts(suffix, ending, Format.PREVIEW, counterpart, options, use_bytes)


def _frames(picture: Format, *, is_counterpart: bool = True) -> VideoFormatFacts:
    facts = FORMATS[picture]
    suffix = f".depth.{FRAME_NUMBER}{facts.ending}"
    counterpart = picture if is_counterpart else None
    return VideoFormatFacts(suffix, None, picture, counterpart, facts.options, facts.use_bytes)


class VideoFormat(StrEnum):
    """What is written of a video; ``--format`` takes these words.

    A member is its word and its :class:`VideoFormatFacts`.
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
            ".depth.mkv", ".mkv", None, Format.PNG16, ("png_scale", "lock"), use_bytes=16
        ),
    )
    MP4 = "mp4", _preview(".mp4", Format.PREVIEW)
    WEBM = "webm", _preview(".webm")
    MOV = "mov", _preview(".mov", use_bytes=24)
    PNG16 = "png16", _frames(Format.PNG16, is_counterpart=False)
    EXR = "exr", _frames(Format.EXR)
    NPY = "npy", _frames(Format.NPY)
    # What the numbers of the others mean.
    JSON = (
        "json",
        VideoFormatFacts(
            ".depth.json", ".json", None, Format.JSON, Format.JSON.facts.options, use_bytes=10
        ),
    )


VIDEO_FORMATS = {which: which.facts for which in VideoFormat}
SEQUENCES = tuple(which for which, facts in VIDEO_FORMATS.items() if facts.is_sequence)
COUNTERPARTS = {
    facts.counterpart: which for which, facts in VIDEO_FORMATS.items() if facts.counterpart
}
"""What a batch writes of a video where it writes this of a picture."""


def video_format_of(path: str | PurePath) -> VideoFormat | None:
    """The format that a file's suffix says, for a whole video; None if it says none."""
    suffix = PurePath(path).suffix.lower()
    return next((which for which, f in VIDEO_FORMATS.items() if f.ending == suffix), None)


def sequence_of(path: str | PurePath) -> VideoFormat | None:
    """The format that the suffix of numbered files says; None if it says none."""
    suffix = PurePath(path).suffix.lower()
    return next((w for w in SEQUENCES if VIDEO_FORMATS[w].suffix.endswith(suffix or "\0")), None)
