"""Video codecs, their encoders and the containers that support them."""

from dataclasses import dataclass
from enum import StrEnum

from depthcli.errors import OutputError, UsageError

DEPTH_PIXELS = "gray16le"
"""FFmpeg's name of the pixels of depth."""
_MIN_SLICED_PX = 16
_CONTAINERS = {".mkv": "matroska", ".mp4": "mp4", ".webm": "webm", ".mov": "mov"}


class Codec(StrEnum):
    """A video codec."""

    FFV1 = "ffv1"
    """Lossless, for depth: 16-bit gray."""
    H264 = "h264"
    """Plays everywhere, browsers included."""
    VP9 = "vp9"
    """Plays in browsers; royalty-free."""
    AV1 = "av1"
    """Small; plays in browsers of recent years."""
    PRORES = "prores"
    """ProRes 422 HQ, 10 bit, for editors."""


class PreviewCodec(StrEnum):
    """The codecs of previews; a subset of :class:`Codec`, with the same names."""

    H264 = "h264"
    VP9 = "vp9"
    AV1 = "av1"
    PRORES = "prores"


@dataclass(frozen=True, slots=True)
class Encoding:
    """The encoder of a codec and its options."""

    encoder: str  #: FFmpeg's name
    pixel_format: str  #: FFmpeg's name of the encoder's input format
    #: of the encoder. The number of threads is fixed, because it can change the bytes
    options: tuple[tuple[str, str], ...]
    is_intra_only: bool = False  #: whether each frame is a keyframe

    def options_for(self, width: int, height: int) -> dict[str, str]:
        """The encoder's options for frames of a size."""
        options = dict(self.options) | {"flags": "+bitexact"}
        if min(width, height) < _MIN_SLICED_PX and "slices" in options:
            options["slices"] = "1"
        return options


ENCODINGS = {
    Codec.FFV1: Encoding(
        "ffv1",
        DEPTH_PIXELS,
        (("level", "3"), ("slices", "4"), ("slicecrc", "1"), ("threads", "4")),
        is_intra_only=True,
    ),
    # Without B-frames, every player shows frames at their exact times. Colours of depth are smooth:
    # finer motion search and partitions double the time for files of the same size and error. With
    # mbtree, about one video in a hundred is not reproducible to the byte.
    Codec.H264: Encoding(
        "libx264",
        "yuv420p",
        (
            *(("preset", "veryfast"), ("crf", "20"), ("bf", "0"), ("threads", "4")),
            *(("subq", "1"), ("weightp", "none"), ("partitions", "none"), ("mbtree", "0")),
        ),
    ),
    Codec.VP9: Encoding(
        "libvpx-vp9",
        "yuv420p",
        (
            *(("crf", "24"), ("b", "0"), ("deadline", "good"), ("cpu-used", "5"), ("row-mt", "1")),
            *(("auto-alt-ref", "0"), ("lag-in-frames", "0"), ("threads", "4")),
        ),
    ),
    Codec.AV1: Encoding(
        "libsvtav1",
        "yuv420p",
        (("preset", "9"), ("crf", "26"), ("svtav1-params", "lp=4:pred-struct=1")),
    ),
    Codec.PRORES: Encoding(
        "prores_ks",
        "yuv422p10le",
        (("profile", "3"), ("vendor", "apl0"), ("threads", "4")),
        is_intra_only=True,
    ),
}
PREVIEW_CODECS = {
    ".mp4": (Codec.H264, Codec.AV1, Codec.VP9),
    ".webm": (Codec.VP9, Codec.AV1),
    ".mov": (Codec.PRORES, Codec.H264),
}
"""Codecs of previews by the file's suffix, the default one first."""


def preview_codec(suffix: str, asked: Codec | None) -> Codec:
    """The codec of a preview: the given one, or the default of its container.

    Raises:
        UsageError: the container does not support that codec.
    """
    choices = PREVIEW_CODECS[suffix]
    if asked is None:
        return choices[0]
    if asked not in choices:
        names = " or ".join(choices)
        raise UsageError(f"a {suffix} file holds no {asked}; give --codec {names}")
    return asked


def container_format(suffix: str) -> str:
    """FFmpeg's name of the container with this suffix."""
    return _CONTAINERS[suffix]


def check_encoder(codec: Codec) -> None:
    """Check that this build of FFmpeg has an encoder.

    Raises:
        OutputError: it is not in PyAV's FFmpeg.
    """
    import av  # noqa: PLC0415 - the command line lists codecs without it

    name = ENCODINGS[codec].encoder
    if name not in av.codecs_available:
        raise OutputError(
            f"{codec} cannot be written here: PyAV has no {name}; install PyAV from its wheels, or "
            "choose another --codec"
        )
