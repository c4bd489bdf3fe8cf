"""Decoding the packets of a video stream, past damaged ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import av

from depthcli.video.container import has_valid_slices
from depthcli.video.time_code import stated_number

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
        ended_early: whether reading stopped at an error or within a packet; valid at the end.
    """

    def __init__(
        self, container: InputContainer, stream: VideoStream, *, is_own: bool = False
    ) -> None:
        """Begin before the first packet.

        Args:
            container: open for reading.
            stream: one of its streams.
            is_own: whether depthcli wrote it, so that all frames of its FFV1 have checksums; other
                files are taken to have them if their first frame has.
        """
        self.ended_early = False
        self._failed = 0
        self._skipped: list[int] = []
        self._corrupt: list[int] = []
        self._is_checked = stream.codec_context.name == _CHECKED_CODEC
        self._has_checksums = True if is_own else None
        self._is_intact = True
        stream.codec_context.copy_opaque = True
        self._packets = container.demux(stream)
        self._frames = self._decoded()

    def next(self) -> VideoFrame | None:
        """The next frame; None at the end."""
        return next(self._frames, None)

    @staticmethod
    def stated_number(frame: VideoFrame) -> int | None:
        """The number that the packet of a frame states; None if it states none."""
        return frame.opaque if isinstance(frame.opaque, int) else None

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
        for packet in iter(self._packet, None):
            if packet.size:  # not at the end
                if packet.is_corrupt:  # by the end of the file, or by a gap before the next packet
                    self._corrupt.append(packet.pts or 0)
                    self.ended_early = True
                    continue
                self._skipped += self._corrupt
                self._corrupt, self.ended_early = [], False
                if self._is_checked and not self._is_valid(packet):
                    # The decoder may still hold earlier frames.
                    self._skipped.append(packet.pts or 0)
                    continue
                packet.opaque = stated_number(packet)
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
