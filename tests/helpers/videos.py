"""Small videos, made when a test needs them."""

import struct
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import av
import numpy as np
from av.video.stream import VideoStream

from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.table import WriterOptions
from depthcli.video.frames import Timing
from depthcli.video.outputs import DepthFrame, DepthVideoOutput, PreviewVideoOutput

NTSC = Fraction(30000, 1001)


def encode(
    path: Any,
    frames: Iterable[np.ndarray[Any, Any]],
    rate: Fraction,
    codec: str,
    pixel_format: str,
    *,
    times_s: Sequence[float] | None = None,
    numbers: Sequence[int] | None = None,
    options: Mapping[str, str] | None = None,
    matrix: Sequence[int] | None = None,
    colours: str = "itu601",
    timecode: str | None = None,
    transfer: int | None = None,
    container: str | None = None,
    aspect: Fraction | None = None,
) -> Path:
    """Frames, RGB(A) in uint8, RGB or gray in uint16, with any codec of FFmpeg's, also to a pipe.

    The container follows from the path's suffix, unless its name is given; ``times_s`` from the
    first frame's, ``numbers`` count intervals of the rate, and ``matrix`` of nine numbers asks for
    a turn. ``timecode`` is of the first frame, ``transfer`` the
    number of the transfer characteristics in H.273, ``aspect`` the width of a pixel by its height.
    """
    if isinstance(path, Path):
        path.parent.mkdir(parents=True, exist_ok=True)
    clock = 1 / rate if times_s is None else Fraction(1, 10_000)  # MPEG-4 takes up to 65535
    output = av.open(str(path) if isinstance(path, Path) else path, "w", format=container)
    output.metadata.update({"timecode": timecode} if timecode else {})
    stream = cast("VideoStream", output.add_stream(codec, rate=rate, options=dict(options or {})))
    stream.time_base = stream.codec_context.time_base = clock
    stream.pix_fmt = pixel_format
    if aspect is not None:
        stream.codec_context.sample_aspect_ratio = aspect
    stream.set_display_matrix(matrix)
    for index, pixels in enumerate(frames):
        if index == 0:
            stream.height, stream.width = pixels.shape[:2]
            if transfer is not None:
                stream.codec_context.color_trc = transfer
            stream.codec_context.colorspace = 1 if colours == "itu709" else 5
        kinds = {(3, 1): "rgb24", (4, 1): "rgba", (3, 2): "rgb48le"}
        kind = kinds.get((pixels.shape[-1], pixels.itemsize), "gray16le")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), kind)
        frame = frame.reformat(format=pixel_format, dst_colorspace=colours)
        place = index if numbers is None else numbers[index]
        frame.pts = place if times_s is None else round(times_s[index] / clock)
        frame.time_base = clock
        output.mux(stream.encode(frame))
    output.mux(stream.encode(None))
    output.close()
    return path


def write_video(
    path: Path, frames: Iterable[np.ndarray[Any, Any]], rate: Fraction = Fraction(25)
) -> Path:
    """RGB frames as Motion JPEG, whose frames are independent and near to what went in."""
    return encode(path, frames, rate, "mjpeg", "yuvj444p", options={"qmin": "1", "qmax": "1"})


def write_mp4(
    path: Path,
    frames: Iterable[np.ndarray[Any, Any]],
    rate: Fraction = NTSC,
    times_s: Sequence[float] | None = None,
) -> Path:
    """RGB frames as MPEG-4 with the exact rate, or with times of their own."""
    return encode(path, frames, rate, "mpeg4", "yuv420p", times_s=times_s, options={"b": "4M"})


def write_ramp(path: Path, count: int = 24) -> Path:
    """A clip at 30000/1001 whose frames get brighter, hence farther for the tiny model."""
    columns = [np.linspace(i, 64 + 7 * i, 64).astype(np.uint8) for i in range(count)]
    return write_mp4(path, [np.tile(column[None, :, None], (48, 1, 3)) for column in columns])


def shot(
    values: np.ndarray[Any, Any], time_s: float = 0.0, kind: DepthKind = DepthKind.METRIC
) -> DepthFrame:
    """Depth of a black frame, shown from 0 to 1."""
    frame = Frame(np.zeros(values.shape, np.uint8), timestamp_s=time_s)
    return DepthFrame(frame, DepthMap(values, kind), (0.0, 1.0))


def write_depth_video(
    path: Path,
    maps: Sequence[np.ndarray[Any, Any]],
    rate: Fraction = NTSC,
    scale: float = 1000.0,
    times_s: Sequence[float] | None = None,
    kind: DepthKind = DepthKind.METRIC,
) -> tuple[str, ...]:
    """Lossless depth; the result are the warnings."""
    with DepthVideoOutput(path, Timing(rate), WriterOptions(png_scale=scale)) as output:
        for i, values in enumerate(maps):
            time_s = float(i / rate) if times_s is None else times_s[i]
            output.append(output.encode(shot(values, time_s, kind)))
        return output.finish()


def write_preview_video(
    path: Path,
    maps: Sequence[np.ndarray[Any, Any]],
    rate: Fraction = NTSC,
    first_s: float = 0.0,
    **options: Any,
) -> tuple[str, ...]:
    """A preview, with codec and audio as options; the result are the warnings."""
    with PreviewVideoOutput(path, Timing(rate), PreviewWriter(), **options) as output:
        for i, values in enumerate(maps):
            output.append(output.encode(shot(values, first_s + float(i / rate))))
        return output.finish()


def damage_frames(path: Path, *numbers: int) -> None:
    """Overwrite a part of some frames."""
    with av.open(str(path)) as container:
        places = [packet.pos for packet in container.demux(video=0) if packet.size]
    data = bytearray(path.read_bytes())
    for number in numbers:
        place = (places[number] or 0) + 3000
        data[place : place + 20] = bytes(20)
    path.write_bytes(data)


def flat_frames(
    levels: Iterable[int], height: int = 48, width: int = 64
) -> list[np.ndarray[Any, np.dtype[np.uint8]]]:
    """Gray frames, each of one brightness."""
    return [np.full((height, width, 3), level, np.uint8) for level in levels]


def trimmed(mp4: bytes, start_s: float, length_s: float) -> bytes:
    """The same file with an edit that shows only a part, as trimming without encoding leaves it."""
    at = mp4.index(b"elst") + 4
    media = mp4.index(b"mdhd") + 4
    movie_ticks, media_ticks = (
        int.from_bytes(mp4[clock : clock + 4]) for clock in (mp4.index(b"mvhd") + 16, media + 12)
    )
    edit = struct.pack(">IiI", round(length_s * movie_ticks), round(start_s * media_ticks), 1 << 16)
    return mp4[: at + 8] + edit + mp4[at + 8 + len(edit) :]


def header_first(mp4: bytes) -> bytes:
    """The same file with its header before its frames, so that it can be cut."""
    at = mp4.index(b"moov") - 4
    start = mp4.index(b"mdat") - 4
    header = bytearray(mp4[at:])
    table = header.index(b"stco") + 8
    count = int.from_bytes(header[table : table + 4])
    for i in range(count):
        place = table + 4 + 4 * i
        struct.pack_into(
            ">I", header, place, int.from_bytes(header[place : place + 4]) + len(header)
        )
    return mp4[:start] + bytes(header) + mp4[start:at]


def with_sound(
    path: Path,
    codec: str = "aac",
    seconds: float = 4,
    begin_s: int = 0,
    timecode: str | None = None,
    rate: int = 48_000,
    layout: str = "mono",
) -> Path:
    """A gray clip with a tone that begins at one second; its clock may begin later than 0."""
    with av.open(str(path), "w") as output:
        output.metadata.update({"timecode": timecode} if timecode else {})
        images = output.add_stream("mpeg4", rate=25)
        images.width, images.height, images.pix_fmt = 64, 48, "yuv420p"
        sound = output.add_stream(codec, rate=rate)
        sound.codec_context.layout = layout
        for index in range(round(seconds * 25)):
            frame = av.VideoFrame.from_ndarray(flat_frames([2 * index])[0], "rgb24")
            frame.pts, frame.time_base = index + 25 * begin_s, Fraction(1, 25)
            output.mux(images.encode(frame))
            first, end = index * rate // 25, (index + 1) * rate // 25
            times_s = np.arange(first, end) / rate
            tone = np.where(times_s < 1, 0, np.sin(2 * np.pi * 440 * times_s) * 9000)
            tone = np.repeat(tone, sound.codec_context.layout.nb_channels)
            samples = av.AudioFrame.from_ndarray(tone[None].astype(np.int16), "s16", layout)
            samples.sample_rate, samples.pts = rate, first + rate * begin_s
            samples.time_base = Fraction(1, rate)
            output.mux(sound.encode(samples))
        output.mux(images.encode(None))
        output.mux(sound.encode(None))
    return path


def box(tag: bytes, *parts: bytes) -> bytes:
    """A box of MP4 and QuickTime."""
    content = b"".join(parts)
    return (8 + len(content)).to_bytes(4) + tag + content


def with_box(mov: bytes, added: bytes, *parents: bytes) -> bytes:
    """The same file, whose header is its end, with a box at the end of the innermost parent."""
    result, at, end = bytearray(mov), 0, 0
    for parent in parents:
        at = result.index(parent, at)
        size = int.from_bytes(result[at - 4 : at])
        end = at - 4 + size
        result[at - 4 : at] = (size + len(added)).to_bytes(4)
    return bytes(result[:end] + added + result[end:])


def with_track_tag(mov: bytes, name: str, kind: int, value: bytes) -> bytes:
    """The same file with QuickTime metadata of the first track."""
    keys = box(b"keys", bytes(4), (1).to_bytes(4), box(b"mdta", name.encode()))
    data = box(b"data", kind.to_bytes(4), bytes(4), value)
    handler = box(b"hdlr", bytes(8), b"mdta", bytes(14))
    meta = box(b"meta", handler, keys, box(b"ilst", box((1).to_bytes(4), data)))
    return with_box(mov, meta, b"moov", b"trak")
