"""The audio of a video's preview: copied if the container supports its codec, else encoded."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, cast

import av

from depthcli.video.container import open_video
from depthcli.video.pipes import InputPipe

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from av.audio.stream import AudioStream
    from av.container import InputContainer, OutputContainer
    from av.packet import Packet

_COPY_CODECS = {
    "mp4": {"aac", "mp3", "ac3", "eac3", "alac", "opus", "flac"},
    "webm": {"opus", "vorbis"},
    "mov": {"aac", "mp3", "ac3", "eac3", "alac", "pcm_s16le", "pcm_s24le"},
}
_ENCODERS = {"mp4": "aac", "webm": "libopus", "mov": "aac"}
_LAYOUTS = {1: "mono", 6: "5.1", 8: "7.1"}
_OPUS_HZ = 48_000
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
        self._output: OutputContainer | None = None
        self._stream: AudioStream | None = None
        self._packets: Iterator[Packet[AudioStream]] = iter(())
        self._pending: Packet[AudioStream] | None = None
        self._is_copied = self.begins_soon = False
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
        name = output.format.name
        self._from_s = self._start_s + Fraction(first_s)
        try:
            self._is_copied = stream.codec_context.name in _COPY_CODECS[name]
            if self._is_copied:
                self._stream = output.add_stream_from_template(stream)
            else:
                rate = _OPUS_HZ if name == "webm" else stream.codec_context.sample_rate
                self._stream = cast(
                    "AudioStream",
                    output.add_stream(_ENCODERS[name], rate, options={"flags": "+bitexact"}),
                )
                channels = stream.codec_context.layout.nb_channels
                self._stream.codec_context.layout = _LAYOUTS.get(channels, "stereo")
        except (av.FFmpegError, ValueError) as error:
            self._report_damage(error)
            return
        self._output = output
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
            self._write(packet)
            self._pending = self._next()

    def finish(self) -> None:
        """Flush the encoder."""
        if self._output is not None and self._stream is not None and not self._is_copied:
            self._output.mux(self._stream.encode(None))

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
            self._report_damage(error)
            return None

    def _write(self, packet: Packet[AudioStream]) -> None:
        if self._output is None or self._stream is None:
            return
        if self._is_copied:
            if _time_s(packet) >= self._from_s:
                shift = round(self._from_s / (packet.time_base or 1))
                packet.pts = (packet.pts or 0) - shift
                packet.dts = packet.pts
                packet.stream = self._stream
                self._output.mux(packet)
            return
        try:
            frames = packet.decode()
        except av.FFmpegError as error:
            self._report_damage(error)
            return
        for frame in frames:
            if frame.pts is None or frame.time_base is None:
                continue
            shift = round(self._from_s / frame.time_base)
            if frame.pts >= shift:
                frame.pts -= shift
                self._output.mux(self._stream.encode(frame))

    def _report_damage(self, error: Exception) -> None:
        reason = getattr(error, "strerror", None) or str(error)
        self.warnings = (
            f"the audio is damaged, so the preview lacks it at least in part: {reason}",
        )


def _time_s(packet: Packet[AudioStream]) -> Fraction:
    return (packet.pts or 0) * Fraction(packet.time_base or 1)
