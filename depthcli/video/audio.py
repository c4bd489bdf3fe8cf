"""Copying the audio of a video into its preview, in step with its frames."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
from av.audio.stream import AudioStream
from av.container import InputContainer, OutputContainer
from av.packet import Packet

from depthcli.errors import Message
from depthcli.video.container import InputPipe, open_video

_COPIED_CODECS = {
    "mp4": {"aac", "mp3", "ac3", "eac3", "alac", "opus", "flac"},
    "webm": {"opus", "vorbis"},
    "mov": {"aac", "mp3", "ac3", "eac3", "alac", "pcm_s16le", "pcm_s24le"},
}


class AudioTrack:
    """The first audio stream of a video, from the time of a preview's first frame on."""

    def __init__(self, source: Path | InputPipe, start_s: Fraction) -> None:
        """Take the source of the audio, and the first frame's time in it."""
        self._source, self._start_s = source, start_s
        self._input: InputContainer | None = None
        self._stream: AudioStream | None = None
        self._packets: Iterator[Packet[AudioStream]] = iter(())
        self._pending: Packet[AudioStream] | None = None
        self._last_ticks = -1
        self.warnings: tuple[str, ...] = ()

    def open(self, output: OutputContainer, first_s: float) -> None:
        """Add a stream, if there is audio; the first frame is ``first_s`` after the video's."""
        if isinstance(self._source, InputPipe):  # which can be read once
            self.warnings = ("the audio of standard input is not in the preview",)
            return
        self._input, _ = open_video(self._source)
        stream = next(iter(self._input.streams.audio), None)
        if stream is None or stream.codec_context is None:
            return
        # The context's own name is the decoder's, such as mp3float.
        codec, name = stream.codec_context.codec.canonical_name, output.format.name
        if codec not in _COPIED_CODECS[name]:
            problem = f"the audio is left out: {codec} cannot be copied into {name}"
            self.warnings = (Message(problem, "convert it, or choose another {format}"),)
            return
        self._output = output
        self._from_s = self._start_s + Fraction(first_s)
        self._stream = output.add_stream_from_template(stream)
        self._packets = self._input.demux(stream)
        self._pending = self._next()
        self.mux_until(0)  # writes nothing; what is before the preview is not heard

    @property
    def begins_soon(self) -> bool:
        """Whether there is audio within a second of the preview's first frame."""
        return self._pending is not None and self._time_s(self._pending) < 1

    def mux_until(self, time_s: float) -> None:
        """Write the audio before a time of the preview; OSError if the file cannot be written."""
        until_s = Fraction(time_s)
        while (packet := self._pending) is not None and self._time_s(packet) < until_s:
            try:
                self._write(packet)
            except (av.FFmpegError, ValueError) as error:
                if isinstance(error, OSError):
                    raise
                self._end(str(error))
                return
            self._pending = self._next()

    def close(self) -> None:
        """Close the source."""
        if self._input is not None:
            self._input.close()
            self._input = None

    def _write(self, packet: Packet[AudioStream]) -> None:
        """Copy a packet, unless it begins before the preview; ValueError if its times go back."""
        ticks = (packet.pts or 0) - round(self._from_s / Fraction(packet.time_base or 1))
        if ticks < 0 or self._stream is None:
            return
        if ticks <= self._last_ticks:  # streams were joined
            raise ValueError("its times go back")
        packet.pts = packet.dts = self._last_ticks = ticks
        packet.stream = self._stream
        self._output.mux(packet)

    def _time_s(self, packet: Packet[AudioStream]) -> Fraction:
        """Time of a packet from the preview's first frame."""
        return (packet.pts or 0) * Fraction(packet.time_base or 1) - self._from_s

    def _next(self) -> Packet[AudioStream] | None:
        """The next packet that has a time."""
        try:
            return next((p for p in self._packets if p.size and p.pts is not None), None)
        except av.FFmpegError as error:
            self._end(error.strerror or str(error))
            return None

    def _end(self, reason: str) -> None:
        self._pending = None
        self.warnings = (f"the audio is damaged, so the preview lacks a part of it: {reason}",)
