"""Decoding the packets of a video stream, past damaged ones, and noticing what is missing."""

from __future__ import annotations

import re
import zlib
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final, cast

import av
from av import logging as av_logging
from av.container import InputContainer
from av.packet import Packet, PacketSideData, packet_sidedata_type_from_literal
from av.video.codeccontext import VideoCodecContext
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from depthcli.errors import InputError
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
        self._frames = self._decoded()

    def next(self) -> VideoFrame | None:
        """The next frame; ``opaque`` is the number that its packet states. None at the end."""
        return next(self._frames, None)

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
