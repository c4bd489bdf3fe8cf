"""From the packets of a video stream to its frames, over damaged places."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import av

from depthcli.video.integrity import slices_are_whole

if TYPE_CHECKING:
    from collections.abc import Iterator

    from av.container import InputContainer
    from av.packet import Packet
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

_CHECKED = "ffv1"


class FrameDecoder:
    """The frames that can be decoded, in the order in which they are shown.

    Attributes:
        ended_early: whether reading stopped at an error or in the middle of a packet.
        read_to: bytes up to the end of the last packet.
    """

    def __init__(self, container: InputContainer, stream: VideoStream) -> None:
        self.ended_early = False
        self.read_to = 0
        self._failed = 0
        self._skipped: list[int] = []
        self._has_checksums = False
        self._is_checked = stream.codec_context.name == _CHECKED
        self._packets = container.demux(stream)
        self._ready: deque[VideoFrame] = deque()
        self._frames = self._decoded()

    def next(self) -> VideoFrame | None:
        """The next frame; None at the end."""
        return next(self._frames, None)

    def take_failed(self, before: int | None = None) -> int:
        """How many frames could not be decoded since this was last asked.

        Those that stood in front of the frame at a time, in the stream's ticks; all of them for
        None.
        """
        early = [at for at in self._skipped if before is None or at < before]
        self._skipped = [at for at in self._skipped if at not in early]
        failed, self._failed = self._failed + len(early), 0
        return failed

    def _decoded(self) -> Iterator[VideoFrame]:
        while (packet := self._packet()) is not None:
            if packet.is_corrupt:  # a part of it is behind the end of the file
                self.ended_early = True
                continue
            if self._is_checked and packet.size and not self._is_whole(packet):
                # The decoder may still hold frames in front of it.
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
            self.read_to = max(self.read_to, packet.pos + packet.size)
        return packet

    def _is_whole(self, packet: Packet[VideoStream]) -> bool:
        """Whether a packet's checksums are right, if the stream has them."""
        is_whole = slices_are_whole(bytes(packet))
        self._has_checksums = self._has_checksums or is_whole
        return is_whole or not self._has_checksums
