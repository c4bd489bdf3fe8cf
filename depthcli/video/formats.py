"""The table of formats for a video's depth; free of numpy, so that help texts can list it."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import PurePath

from depthcli.errors import OutputError, UsageError
from depthcli.io.formats.table import Format, FormatFacts, TableOfFormats, stem_of

FRAME_NUMBER = "%06d"  #: placeholder of the frame's number in the name of a sequence


_OF_DEPTH = "png_scale", "lock", "vmin", "vmax"
_OF_PREVIEWS = "lock", "codec", "audio"


def _colours(image: Format, suffix: str, file_suffix: str | None = None) -> FormatFacts:
    """The entry of a video of colours, whose frames are drawn as such images."""
    options = (*image.facts.options, *_OF_PREVIEWS)
    return image.facts._replace(suffix=suffix, file_suffix=file_suffix, options=options)


def _frames(image: Format) -> FormatFacts:
    """The entry of a file for each frame, which no file suffix chooses."""
    end = PurePath(image.facts.suffix)
    numbered = f"{end.stem}.{FRAME_NUMBER}{end.suffix}"
    return image.facts._replace(suffix=numbered, file_suffix=None)


class VideoFormat(TableOfFormats):
    """Output formats of a video's depth, the values of ``--format``, with the columns of images.

    Options are those of the command, by the names of their parameters.
    """

    facts: FormatFacts

    # Lossless 16-bit video.
    MKV = "mkv", FormatFacts("", ".depth.mkv", ".mkv", options=_OF_DEPTH)
    MP4 = "mp4", _colours(Format.PREVIEW, ".preview.mp4", ".mp4")
    WEBM = "webm", _colours(Format.PREVIEW, ".preview.webm", ".webm")
    MOV = "mov", _colours(Format.PREVIEW, ".preview.mov", ".mov")
    STEREO = "stereo", _colours(Format.STEREO, ".stereo.mp4")
    PNG16 = "png16", _frames(Format.PNG16)
    EXR = "exr", _frames(Format.EXR)
    NPY = "npy", _frames(Format.NPY)
    NORMALS = "normals", _frames(Format.NORMALS)
    NORMALS_EXR = "normals-exr", _frames(Format.NORMALS_EXR)
    # What the numbers of the others mean.
    JSON = "json", Format.JSON.facts._replace(range_options=())
    # Every other format of images that is read back is that of a sequence as well.
    _ignore_ = "image"
    for image in Format:
        if image.facts.is_readable and image.name not in vars():
            vars()[image.name] = image.value, _frames(image)


VIDEOS = (VideoFormat.MKV, VideoFormat.MP4, VideoFormat.WEBM, VideoFormat.MOV)
SEQUENCES = {word: Format(word) for word in VideoFormat if FRAME_NUMBER in word.facts.suffix}
"""The formats that write a file for each frame, and the format of images of each."""
COUNTERPARTS = {
    **{image: which for which, image in SEQUENCES.items()},
    Format.PNG16: VideoFormat.MKV,
    Format.PREVIEW: VideoFormat.MP4,
    Format.STEREO: VideoFormat.STEREO,
    Format.JSON: VideoFormat.JSON,
}  #: the format that a batch writes for videos, by the format it writes for images


def video_format_of(path: str | PurePath) -> VideoFormat | None:
    """The format of a whole video that a file's suffix chooses; None if it chooses none."""
    name = PurePath(path).name.lower()
    if name.endswith(VideoFormat.STEREO.facts.suffix):
        return VideoFormat.STEREO
    suffix = PurePath(path).suffix.lower()
    return next((format_ for format_ in VideoFormat if format_.facts.file_suffix == suffix), None)


def sequence_of(path: str | PurePath) -> VideoFormat | None:
    """The format that the suffix of numbered files chooses; None if it chooses none."""
    suffix = PurePath(path).suffix.lower()
    return next((w for w in SEQUENCES if w.facts.suffix.endswith(suffix or "\0")), None)


def video_stem_of(path: str | PurePath) -> str:
    """A file's name without the suffix of its format: ``a`` of ``a.mkv`` and ``a.preview.mp4``.

    What selects no format is part of the name: ``shot.v003`` is its own stem.
    """
    files = [format_.facts for format_ in VideoFormat if format_ not in SEQUENCES]
    chosen = (facts.file_suffix for facts in files if facts.file_suffix)
    return stem_of(path, (*(facts.suffix for facts in files), *chosen))


DEPTH_PIXELS = "gray16le"  #: FFmpeg's name of the pixels of depth
CONTAINERS = {".mkv": "matroska", ".mp4": "mp4", ".webm": "webm", ".mov": "mov"}
"""FFmpeg's names of containers, by the file's suffix."""


FFV1 = "ffv1"  #: the codec of depth: lossless, 16-bit gray


class PreviewCodec(StrEnum):
    """The codecs of previews."""

    H264 = "h264"  #: plays everywhere, browsers included
    VP9 = "vp9"  #: plays in browsers; royalty-free
    AV1 = "av1"  #: small; plays in browsers of recent years
    PRORES = "prores"  #: ProRes 422 HQ, 10 bit, for editors


@dataclass(frozen=True, slots=True)
class Encoding:
    """The encoder of a codec and its options."""

    encoder: str  #: FFmpeg's name
    pixel_format: str  #: FFmpeg's name of the encoder's input format
    #: of the encoder. The number of threads is fixed, because it can change the bytes
    options: tuple[tuple[str, str], ...]
    is_intra_only: bool = False  #: whether each frame is a keyframe


ENCODINGS = {
    FFV1: Encoding(
        "ffv1",
        DEPTH_PIXELS,
        (("level", "3"), ("slices", "4"), ("slicecrc", "1"), ("threads", "4")),
        is_intra_only=True,
    ),
    # Without B-frames, every player shows frames at their exact times. Colours of depth are smooth:
    # finer motion search and partitions double the time for files of the same size and error. With
    # mbtree, about one video in a hundred is not reproducible to the byte.
    PreviewCodec.H264: Encoding(
        "libx264",
        "yuv420p",
        (
            *(("preset", "veryfast"), ("crf", "20"), ("bf", "0"), ("threads", "4")),
            *(("subq", "1"), ("weightp", "none"), ("partitions", "none"), ("mbtree", "0")),
        ),
    ),
    PreviewCodec.VP9: Encoding(
        "libvpx-vp9",
        "yuv420p",
        (
            *(("crf", "24"), ("b", "0"), ("deadline", "good"), ("cpu-used", "5"), ("row-mt", "1")),
            *(("auto-alt-ref", "0"), ("lag-in-frames", "0"), ("threads", "4")),
        ),
    ),
    PreviewCodec.AV1: Encoding(
        "libsvtav1",
        "yuv420p",
        (("preset", "9"), ("crf", "26"), ("svtav1-params", "lp=4:pred-struct=1")),
    ),
    PreviewCodec.PRORES: Encoding(
        "prores_ks",
        "yuv422p10le",
        (("profile", "3"), ("vendor", "apl0"), ("threads", "4")),
        is_intra_only=True,
    ),
}
PREVIEW_CODECS = {
    ".mp4": (PreviewCodec.H264, PreviewCodec.AV1, PreviewCodec.VP9),
    ".webm": (PreviewCodec.VP9, PreviewCodec.AV1),
    ".mov": (PreviewCodec.PRORES, PreviewCodec.H264),
}  #: codecs of previews by the file's suffix, the default one first


def preview_codec(format_: VideoFormat, codec: PreviewCodec | None = None) -> PreviewCodec:
    """The codec of a preview: the given one, which the container has to hold, or its default."""
    suffix = PurePath(format_.facts.suffix).suffix
    choices = PREVIEW_CODECS[suffix]
    if codec is not None and codec not in choices:
        names = " or ".join(choices)
        raise UsageError(f"a {suffix} file holds no {codec}", f"give {{codec}} {names}")
    return codec or choices[0]


def check_encoder(codec: str) -> None:
    """Check that this build of FFmpeg has an encoder; OutputError if it is not in PyAV's FFmpeg."""
    import av  # noqa: PLC0415 - the command line lists codecs without it

    name = ENCODINGS[codec].encoder
    if name not in av.codecs_available:
        raise OutputError(
            f"{codec} cannot be written here: PyAV has no {name}",
            "install PyAV from its wheels, or choose another {codec}",
        )
