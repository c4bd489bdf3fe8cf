"""Decoding a video stream past damaged packets, and making upright RGB images of its frames."""

from __future__ import annotations

import math
import re
import struct
import zlib
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Final, cast

import av
import numpy as np
from av import logging as av_logging
from av.container import InputContainer
from av.packet import Packet, PacketSideData, packet_sidedata_type_from_literal
from av.sidedata.sidedata import Type
from av.video.codeccontext import VideoCodecContext
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange, Colorspace, Interpolation, VideoReformatter
from av.video.stream import VideoStream

from depthcli.core import imageops, types
from depthcli.core.options import Eye, Projection, ReadOptions
from depthcli.errors import InputError, Message, UsageError
from depthcli.io.images.pixels import from_video_range, full_range, upright
from depthcli.io.images.read import masked
from depthcli.video.container import open_video

_CHECKED_CODEC = "ffv1"
_WITH_ALPHA = {"vp8": "libvpx", "vp9": "libvpx-vp9"}  #: FFmpeg's own decoders leave it out
_MATROSKA = "matroska,webm"
_STATED_NUMBER: Final = "matroska_block_additional"
_ID_BYTES = 8
_ID = 1  #: of data that only the codec or the program defines (BlockAddID)
_SLICE_FOOTER_BYTES = 8  # bytes: three of the slice's size, one of its state, four of its checksum
_BIT_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_ONES = 0xFFFFFFFF
_MOST_PACKETS = 1000


class FrameDecoder:
    """The frames that can be decoded, in display order.

    Attributes:
        frames: an iterator of them; ``opaque`` is the number that a frame's packet states.
        ended_early: whether reading stopped at an error or within a packet; valid at the end.
        has_gaps: whether the container marked a packet beside which data may be missing.
    """

    def __init__(
        self, container: InputContainer, stream: VideoStream, *, is_own: bool = False
    ) -> None:
        """Begin before the first packet of a stream.

        All frames of FFV1 that depthcli wrote (``is_own``) have checksums; other files are taken to
        have them if their first frame has.
        """
        self.ended_early = self.has_gaps = False
        self._failed = 0
        self._skipped: list[int] = []
        self._stream = stream
        self._is_transport_stream = container.format.name == "mpegts"
        self._since_keyframe: deque[Packet[VideoStream]] = deque(maxlen=_MOST_PACKETS)
        self._is_checked = stream.codec_context.name == _CHECKED_CODEC
        self._has_checksums = True if is_own else None
        self._is_intact = True
        stream.codec_context.copy_opaque = True
        self._context = stream.codec_context
        with_alpha = _WITH_ALPHA.get(self._context.name, "")
        if stream.metadata.get("alpha_mode") == "1" and with_alpha in av.codecs_available:
            self._context = cast("VideoCodecContext", av.CodecContext.create(with_alpha, "r"))
        self._packets = container.demux(stream)
        self.frames = self._decoded()

    def pop_failed(self, before: int | None = None) -> int:
        """Number of frames that could not be decoded since the last call, up to a time in ticks."""
        early = [at for at in self._skipped if before is None or at < before]
        self._skipped = [at for at in self._skipped if at not in early]
        failed, self._failed = self._failed + len(early), 0
        return failed

    def _decoded(self) -> Iterator[VideoFrame]:
        for packet in self._whole_packets():
            if packet.size:  # not at the end
                if self._is_checked and not self._is_valid(packet):
                    # The decoder may still hold earlier frames.
                    self._skipped.append(packet.pts or 0)
                    continue
                packet.opaque = _stated_number(packet)
            try:
                frames = self._context.decode(packet)
            except (av.FFmpegError, EOFError):
                self._failed += 1
                continue
            for frame in frames:
                if frame.is_corrupt:
                    self._failed += 1
                else:
                    yield frame

    def _whole_packets(self) -> Iterator[Packet[VideoStream]]:
        """The packets without those that are incomplete.

        MPEG-TS marks the packet before a gap in its counters, which is whole where recordings were
        joined. The last packet of a file that is cut off is marked as well.
        """
        marked: Packet[VideoStream] | None = None
        for packet in iter(self._packet, None):
            if marked is not None and packet.size:
                if self._is_whole(marked):
                    yield marked
                else:
                    self._skipped.append(marked.pts or 0)
                marked, self.has_gaps = None, True
            if packet.is_keyframe:
                self._since_keyframe.clear()
            if packet.size and self._is_transport_stream:
                self._since_keyframe.append(packet)
            if packet.size and packet.is_corrupt:
                marked = packet
                continue
            self.ended_early |= marked is not None
            yield packet

    def _is_whole(self, marked: Packet[VideoStream]) -> bool:
        """Whether a strict decoder takes the last packet since the keyframe without an error."""
        name = self._stream.codec_context.codec.name
        context = cast("VideoCodecContext", av.CodecContext.create(name, "r"))
        context.extradata, context.thread_count = self._stream.codec_context.extradata, 1
        context.options = {"err_detect": "explode"}
        is_whole = False
        for packet in self._since_keyframe:
            with suppress(av.FFmpegError, EOFError):
                context.decode(packet)
                is_whole = packet is marked
        return is_whole

    def _packet(self) -> Packet[VideoStream] | None:
        try:
            return next(self._packets, None)
        except av.FFmpegError:
            self.ended_early = True
            return None

    def _is_valid(self, packet: Packet[VideoStream]) -> bool:
        """Whether a packet's checksums are right and no damage precedes it up to its keyframe."""
        is_valid = has_valid_slices(bytes(packet))
        if self._has_checksums is None:
            self._has_checksums = is_valid
        if self._has_checksums:
            self._is_intact = is_valid and (self._is_intact or packet.is_keyframe)
        return self._is_intact


def state_number(packet: Packet[VideoStream], number: int) -> None:
    """State the number of its frame in a packet that is not written yet.

    In Matroska, as additional data of the block: its header is written with the first frame, before
    it is known which later ones are missing.
    """
    data = _ID.to_bytes(_ID_BYTES) + f"{number}".encode()
    kind = packet_sidedata_type_from_literal(_STATED_NUMBER)
    side_data = PacketSideData(kind, len(data))  # type: ignore[call-arg] # missing in PyAV's stubs
    side_data.update(data)
    packet.set_sidedata(side_data)


def _stated_number(packet: Packet[VideoStream]) -> int | None:
    if not packet.has_sidedata(_STATED_NUMBER):
        return None
    text = bytes(packet.get_sidedata(_STATED_NUMBER))[_ID_BYTES:]
    return int(text) if re.fullmatch(rb"\d{1,18}", text) else None


def has_valid_slices(packet: bytes) -> bool:
    """Whether the checksum of every slice of an FFV1 frame is right (RFC 9043, 4.9.3).

    The frame is of version 3, with checksums. FFmpeg replaces damaged slices with those of the
    frame before, and only logs it.
    """
    end = len(packet)
    while end > 0:
        size = int.from_bytes(packet[max(0, end - 8) : max(0, end - 5)])
        start = end - _SLICE_FOOTER_BYTES - size
        # CRC-32 with the most significant bit first and an initial value of 0, bit-reversed.
        data = packet[max(0, start) : end].translate(_BIT_REVERSED)
        if start < 0 or zlib.crc32(data, _ONES) ^ _ONES:
            return False
        end = start
    return bool(packet)


def is_incomplete_matroska(path: Path, container: InputContainer) -> bool:
    """Whether a Matroska or WebM file is truncated or has a gap; False for other containers.

    FFmpeg's demuxer skips such places without an error, and only logs them. The file is read once
    more, without decoding.
    """
    if container.format.name != _MATROSKA:
        return False
    level, skips = av_logging.get_level(), av_logging.get_skip_repeated()
    av_logging.set_level(av_logging.ERROR)
    av_logging.set_skip_repeated(False)
    try:
        with av_logging.Capture() as log:
            again, stream = open_video(path)
            with again:
                for _ in again.demux(stream):
                    pass
    except (av.FFmpegError, InputError):  # or it was removed meanwhile
        return True
    finally:
        av_logging.set_level(level)
        av_logging.set_skip_repeated(skips)
    return any(name == _MATROSKA for _, name, _ in log)


_EIGHT_BIT = 8
_UNSPECIFIED = 2
_SD_ROWS = 576
_TOLERANCE = 0.02
# Scales and shears of the display matrices of the EXIF orientations 1 to 8.
_UPRIGHT = ((1, 0, 0, 1), (-1, 0, 0, 1), (-1, 0, 0, -1), (1, 0, 0, -1))
_MATRICES = (*_UPRIGHT, (0, 1, 1, 0), (0, 1, -1, 0), (0, -1, -1, 0), (0, -1, 1, 0))
_EXIF_OF_ANGLE = {90: 8, 180: 3, 270: 6}  # in degrees, counter-clockwise


def rgb_pixels(
    frame: VideoFrame, reformatter: VideoReformatter, *, has_alpha: bool = False
) -> types.UInt8Array | types.UInt16Array:
    """A frame converted to RGB from its own colour space and range, not rotated.

    If it states no colour space, that is BT.601 up to 576 rows and BT.709 above, as in players.
    The pixels are (H, W, 3), or (H, W, 4) with alpha: uint8 of 8-bit video, else uint16 up to
    65535. Raises av.FFmpegError if the format cannot be converted.
    """
    is_deep = any(component.bits > _EIGHT_BIT for component in frame.format.components)
    guessed = Colorspace.ITU709 if frame.height > _SD_ROWS else Colorspace.ITU601
    formats = ("rgba", "rgba64le") if has_alpha else ("rgb24", "rgb48le")
    rgb = reformatter.reformat(
        frame,
        format=formats[is_deep],
        src_colorspace=guessed if frame.colorspace == _UNSPECIFIED else None,
        dst_color_range=ColorRange.JPEG,
        interpolation=Interpolation.BICUBIC,
    )
    pixels: types.UInt8Array | types.UInt16Array = rgb.to_ndarray()  # type: ignore[assignment]
    is_limited = frame.color_range == ColorRange.MPEG and frame.format.name.startswith("gray")
    return from_video_range(pixels) if is_limited else pixels  # FFmpeg takes gray as it is


def orientation_of(frame: VideoFrame) -> int:
    """The EXIF orientation (1-8) of a frame's display matrix; 1 for other angles."""
    data = side_data(frame, Type.DISPLAYMATRIX)
    if data is None:  # or beside a kind that PyAV does not know, such as that of EXIF
        return _EXIF_OF_ANGLE.get(frame.rotation % 360, 1)
    a, b, _, c, d = np.frombuffer(data, "<i4")[:5].tolist()
    across, down = math.hypot(a, c) or 1, math.hypot(b, d) or 1  # the matrix may scale as well
    shares = a / across, b / down, c / across, d / down
    turns = (np.allclose(shares, matrix, atol=_TOLERANCE) for matrix in _MATRICES)
    return next((number for number, fits in enumerate(turns, start=1) if fits), 1)


_SIDE_BY_SIDE, _TOP_BOTTOM = 1, 2
_PACKED = {_SIDE_BY_SIDE: "side by side", _TOP_BOTTOM: "one above the other"}
_INTERLEAVED = range(3, 8)
_LEAST_SHAPE, _TWO_SQUARES = Fraction(5, 4), 2  # width by height of one image, and of two
_PROJECTIONS = {0: Projection.EQUIRECTANGULAR, 1: "cubemap", 2: "tiles", 3: "VR180", 5: "fisheye"}
"""Projections that are not flat, by FFmpeg's numbers."""


def camera_warnings(
    frame: VideoFrame, eye: Eye | None, projection: Projection | None
) -> Iterator[str]:
    """Warnings by the first frame, but not about a view or a projection that is given."""
    if warning := imageops.transfer_warning(frame.color_trc, "video", "BT.709"):
        yield warning
    if frame.interlaced_frame:
        yield Message(
            "the video is interlaced, and the network sees both fields of a frame at once",
            "deinterlace it first: ffmpeg -i in.mov -vf yadif -c:v ffv1 out.mkv",
        )
    stereo, spherical = _stereo(frame), side_data(frame, Type.SPHERICAL)
    if stereo is None and eye is not None:
        yield "the video states no stereo layout; two views side by side are assumed"
    if stereo is not None and eye is None:
        layout = _PACKED.get(stereo[0], "interleaved")
        yield Message(
            f"each frame holds two views, {layout}, which the network takes for one image",
            "choose one with {eye}",
        )
    sphere = _PROJECTIONS.get(struct.unpack_from("<i", spherical)[0]) if spherical else None
    if sphere is Projection.EQUIRECTANGULAR and projection is None:
        yield imageops.PANORAMA
    elif sphere not in {None, projection}:
        yield f"its frames are a panorama ({sphere}), which is taken for another projection"


def view_of(frame: VideoFrame, eye: Eye | None) -> tuple[slice, slice]:
    """Rows and columns of one view of a stereo frame; UsageError if views are interleaved."""
    whole = slice(None)
    if eye is None:
        return whole, whole
    kind, is_inverted = _stereo(frame) or (_SIDE_BY_SIDE, False)
    if kind not in _PACKED:
        raise UsageError("its two views are interleaved", "separate them first", option="eye")
    size = frame.width if kind == _SIDE_BY_SIDE else frame.height
    is_first = (eye is Eye.LEFT) != is_inverted
    half = slice(size // 2) if is_first else slice(size - size // 2, None)
    return (whole, half) if kind == _SIDE_BY_SIDE else (half, whole)


def squeeze_of(frame: VideoFrame, pixel_aspect: Fraction, options: ReadOptions) -> Fraction:
    """Width by height of a pixel of one view, by that of a pixel of the frame.

    Half of the width of each view is kept side by side, half of its height one above the other,
    if the frame has the shape of one image; no container states it.
    """
    kind, shape = (_stereo(frame) or (_SIDE_BY_SIDE,))[0], pixel_aspect * frame.width / frame.height
    is_flat = side_data(frame, Type.SPHERICAL) is None and options.projection is None
    if options.eye is None or shape < _LEAST_SHAPE or not is_flat:
        return Fraction(1)
    if kind == _TOP_BOTTOM:
        return Fraction(1, 2)
    return Fraction(2 if shape < _TWO_SQUARES else 1)


def _stereo(frame: VideoFrame) -> tuple[int, bool] | None:
    """FFmpeg's number of the stereo layout, and whether right is first; None for one view."""
    data = side_data(frame, Type.STEREO3D)
    kind, flags = struct.unpack_from("<2i", data) if data else (0, 0)
    return (kind, bool(flags & 1)) if kind in {*_PACKED, *_INTERLEAVED} else None


def side_data(frame: VideoFrame, kind: Any) -> bytes | None:  # noqa: ANN401 - PyAV's enum
    """Data of one kind beside a frame; None if there is none, or a kind that PyAV does not know."""
    try:
        beside: Any = frame.side_data  # whose type is stated wrongly
        entry = beside.get(kind)
    except ValueError:
        return None
    return None if entry is None else bytes(entry)


_RGB = 3
_TRANSPOSED = 5  # the first EXIF orientation that swaps rows and columns


class FrameConverter:
    """Makes upright images of decoded frames, which all have the facts of the first one.

    Attributes:
        width: columns of an upright frame.
        height: rows of an upright frame.
        warnings: one line each about the first frame, but not about its pixels.
    """

    def __init__(
        self, first: VideoFrame, pixel_aspect: Fraction | None, options: ReadOptions
    ) -> None:
        """Read what only a decoded frame states."""
        self._options, self._reformatter = options, VideoReformatter()
        self._orientation = orientation_of(first)
        self._view = rows, columns = view_of(first, options.eye)
        size = len(range(first.width)[columns]), len(range(first.height)[rows])
        is_turned = self._orientation >= _TRANSPOSED
        self.width, self.height = size[::-1] if is_turned else size
        squeeze = squeeze_of(first, pixel_aspect or Fraction(1), options)
        aspect = (pixel_aspect or 1) * squeeze
        self._pixel_aspect = types.pixel_aspect_of(aspect, is_turned=is_turned)
        self._is_begun = False
        self.warnings = tuple(camera_warnings(first, options.eye, options.projection))
        if squeeze != 1:
            problem = (
                f"views of {size[0]}×{size[1]} are taken as squeezed: pixels are {aspect} wide"
            )
            self.warnings += (Message(problem, "{pixel_aspect} states another width"),)

    def image(self, decoded: VideoFrame, index: int, time_s: Fraction) -> types.Frame:
        """A frame, upright; where it is transparent, with the colours around that.

        The first one has the warnings about its pixels. InputError if it cannot be converted, or
        has another size than the first one.
        """
        options, components = self._options, decoded.format.components
        has_alpha = any(component.is_alpha for component in components) and not options.ignore_alpha
        try:
            pixels = rgb_pixels(decoded, self._reformatter, has_alpha=has_alpha)
        except av.FFmpegError as error:
            problem = "a frame cannot be converted; the frames before it are done"
            raise InputError(problem) from error
        pixels = upright(pixels[self._view], self._orientation)
        rgb, warnings = pixels[..., :_RGB], tuple[str, ...]()
        if rgb.shape[:2] != (self.height, self.width):
            raise InputError("the frames change their size; those before are done")
        is_first, self._is_begun = not self._is_begun, True
        if is_first or options.white_level is not None or options.black_level:
            rgb, warnings = full_range(rgb, None, options.white_level, options.black_level)
        frame = types.Frame(
            rgb if rgb.flags.c_contiguous else rgb.copy(),
            index=index,
            timestamp_s=float(time_s),
            orientation=self._orientation,
            warnings=warnings,
            pixel_aspect=self._pixel_aspect,
            projection=options.projection or Projection.PINHOLE,
        )
        if has_alpha:
            try:
                frame = masked(frame, pixels[..., _RGB])
            except InputError:  # nothing is seen, as before a fade
                frame = replace(frame, transparent=np.ones(rgb.shape[:2], np.bool_))
        return frame if is_first else replace(frame, warnings=())
