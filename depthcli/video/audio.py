"""The audio of a video's preview, in step with its frames."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import av

from depthcli.video.audio_output import AudioOutput, damage_text
from depthcli.video.container import open_video
from depthcli.video.pipes import InputPipe

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from av.audio.stream import AudioStream
    from av.container import InputContainer, OutputContainer
    from av.packet import Packet

_DECODER_DELAY_S = 0.25  # more than samples are later than their packet
_SOON_S = 1


class AudioTrack:
    """The first audio stream of a video, from the time of a preview's first frame on.

    Attributes:
        begins_soon: whether there is audio within a second of the preview's first frame, once it
            is open.
        warnings: one-line texts, once it has been written.
    """

    def __init__(self, source: Path | InputPipe, start_s: Fraction) -> None:
        """Take the source of the audio, and the first frame's time in it."""
        self._source = source
        self._start_s = start_s
        self._input: InputContainer | None = None
        self._output: AudioOutput | None = None
        self._packets: Iterator[Packet[AudioStream]] = iter(())
        self._pending: Packet[AudioStream] | None = None
        self.begins_soon = False
        self.warnings: tuple[str, ...] = ()

    def open(self, output: OutputContainer, first_s: float) -> None:
        """Add an audio stream to a file whose header is not written yet, if the video has audio.

        The preview's first frame is ``first_s`` after the video's.
        """
        if isinstance(self._source, InputPipe):  # which can be read once
            self.warnings = ("the audio of standard input is not in the preview",)
            return
        container, _ = open_video(self._source)
        self._input = container
        stream = next(iter(container.streams.audio), None)
        if stream is None or stream.codec_context is None:
            return
        self._from_s = self._start_s + Fraction(first_s)
        try:
            self._output = AudioOutput(output, stream, self._from_s)
        except (av.FFmpegError, ValueError) as error:
            self._report_damage(damage_text(error))
            return
        self._packets = container.demux(stream)
        self._pending = self._next()
        self.mux_until(-_DECODER_DELAY_S)  # writes nothing; such packets are not heard
        pending = self._pending
        self.begins_soon = pending is not None and _time_s(pending) - self._from_s < _SOON_S

    def mux_until(self, time_s: float) -> None:
        """Write the audio before a time of the preview."""
        until_s = Fraction(time_s)
        while self._pending is not None and _time_s(self._pending) - self._from_s < until_s:
            packet, self._pending = self._pending, None
            if self._output is not None:
                self._output.write(packet)
            self._pending = self._next()

    def finish(self) -> None:
        """Flush the encoder."""
        if self._output is not None:
            self._output.finish()
            self._report_damage(self._output.damage)

    def close(self) -> None:
        """Close the source."""
        if self._input is not None:
            self._input.close()
            self._input = None

    def _next(self) -> Packet[AudioStream] | None:
        """The next packet that has a time."""
        try:
            return next((p for p in self._packets if p.size and p.pts is not None), None)
        except av.FFmpegError as error:
            self._report_damage(damage_text(error))
            return None

    def _report_damage(self, reason: str | None) -> None:
        if reason is not None:
            self.warnings = (
                f"the audio is damaged, so the preview lacks it at least in part: {reason}",
            )


def _time_s(packet: Packet[AudioStream]) -> Fraction:
    return (packet.pts or 0) * Fraction(packet.time_base or 1)
