"""Decoding the packets of a video stream, past damaged ones."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import av

from depthcli.video.integrity import has_valid_slices

if TYPE_CHECKING:
    from collections.abc import Iterator

    from av.container import InputContainer
    from av.packet import Packet
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

_CHECKED_CODEC = "ffv1"


class FrameDecoder:
    """The frames that can be decoded, in display order.

    Attributes:
        ended_early: whether reading stopped at an error or within a packet.
        end_position: of the last packet, in bytes from the beginning of the file.
    """

    def __init__(self, container: InputContainer, stream: VideoStream) -> None:
        self.ended_early = False
        self.end_position = 0
        self._failed = 0
        self._skipped: list[int] = []
        self._has_checksums = False
        self._is_checked = stream.codec_context.name == _CHECKED_CODEC
        self._packets = container.demux(stream)
        self._ready: deque[VideoFrame] = deque()
        self._frames = self._decoded()

    def next(self) -> VideoFrame | None:
        """The next frame; None at the end."""
        return next(self._frames, None)

    def pop_failed(self, before: int | None = None) -> int:
        """How many frames could not be decoded since the last call.

        Args:
            before: only those before this time, in ticks of the stream; None for all.
        """
        early = [at for at in self._skipped if before is None or at < before]
        self._skipped = [at for at in self._skipped if at not in early]
        failed, self._failed = self._failed + len(early), 0
        return failed

    def _decoded(self) -> Iterator[VideoFrame]:
        while (packet := self._packet()) is not None:
            if packet.is_corrupt:  # it is truncated by the end of the file
                self.ended_early = True
                continue
            if self._is_checked and packet.size and not self._is_valid(packet):
                # The decoder may still hold earlier frames.
                self._skipped.append(packet.pts or 0)
                continue
            try:
                frames = packet.decode()
            except (av.FFmpegError, EOFError):
                self._failed += 1
                continue
            for frame in frames:
                if frame.is_corrupt:
                    self._failed += 1
                else:
                    yield frame

    def _packet(self) -> Packet[VideoStream] | None:
        try:
            packet = next(self._packets, None)
        except av.FFmpegError:
            self.ended_early = True
            return None
        if packet is not None and packet.pos is not None:
            self.end_position = max(self.end_position, packet.pos + packet.size)
        return packet

    def _is_valid(self, packet: Packet[VideoStream]) -> bool:
        """Whether a packet's checksums are right, or the stream has none."""
        is_whole = has_valid_slices(bytes(packet))
        self._has_checksums = self._has_checksums or is_whole
        return is_whole or not self._has_checksums
