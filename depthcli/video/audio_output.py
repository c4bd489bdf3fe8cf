"""An audio stream of a preview: copied if the container supports its codec, else encoded."""

from __future__ import annotations

import math
from contextlib import contextmanager
from fractions import Fraction
from typing import TYPE_CHECKING, Any, cast

import av
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from av.audio.frame import AudioFrame
    from av.audio.stream import AudioStream
    from av.container import OutputContainer
    from av.packet import Packet

_COPY_CODECS = {
    "mp4": {"aac", "mp3", "ac3", "eac3", "alac", "opus", "flac"},
    "webm": {"opus", "vorbis"},
    "mov": {"aac", "mp3", "ac3", "eac3", "alac", "pcm_s16le", "pcm_s24le"},
}
_PCM_BYTES = {"pcm_s16le": 2, "pcm_s24le": 3}
_ENCODERS = {"mp4": "aac", "webm": "libopus", "mov": "aac"}
_LAYOUTS = {1: "mono", 6: "5.1", 8: "7.1"}
_OPUS = "webm"
_MP4_MIN_MP3_HZ = 16_000
_USUAL_HZ = 48_000


class AudioOutput:
    """Audio from a time of its source on, without what is damaged.

    Attributes:
        damage: why a part of it is missing; None if nothing is.
    """

    def __init__(self, output: OutputContainer, source: AudioStream, from_s: Fraction) -> None:
        """Add a stream to a file whose header is not written yet.

        Args:
            output: the file.
            source: the audio.
            from_s: time in the source that becomes 0; what is before it is left out.

        Raises:
            av.FFmpegError: the audio cannot be written to such a file.
            ValueError: the same.
        """
        name = output.format.name
        self.damage: str | None = None
        self._output, self._from_s = output, from_s
        self._last_s = Fraction(-1)
        self._resampler: av.AudioResampler | None = None
        self._resampled: tuple[str, str, int] | None = None
        self._is_copied = _can_copy(name, source)
        if self._is_copied:
            self._stream = output.add_stream_from_template(source)
            return
        rate = _supported_hz(name, source.codec_context.sample_rate)
        self._stream = cast(
            "AudioStream", output.add_stream(_ENCODERS[name], rate, options={"flags": "+bitexact"})
        )
        channels = source.codec_context.layout.nb_channels
        self._stream.codec_context.layout = _LAYOUTS.get(channels, "stereo")

    def write(self, packet: Packet[AudioStream]) -> None:
        """Write a packet of the source that has a time.

        Raises:
            OSError: the file cannot be written.
        """
        if not self._is_copied:
            for frame in self._decoded(packet):
                self._encode(frame)
            return
        time_base = Fraction(packet.time_base or 1)
        begin_ticks = round(self._from_s / time_base)
        ticks, early = (packet.pts or 0) - begin_ticks, self._early_bytes(packet, time_base)
        if early:
            packet = cast("Packet[AudioStream]", av.Packet(bytes(packet)[early:]))
            packet.time_base, ticks = time_base, 0
        if self._is_next(self._from_s + ticks * time_base):
            packet.pts = packet.dts = ticks
            packet.stream = self._stream
            with self._damage_reported():
                self._output.mux(packet)

    def _early_bytes(self, packet: Packet[AudioStream], time_base: Fraction) -> int:
        """Size of the samples before the beginning in a packet of PCM; 0 of other packets."""
        context = self._stream.codec_context
        sample = _PCM_BYTES.get(context.name, 0) * context.layout.nb_channels
        early_s = self._from_s - (packet.pts or 0) * time_base
        early = max(0, math.ceil(early_s * context.sample_rate)) * sample
        return early if early < packet.size else 0

    def finish(self) -> None:
        """Flush the encoder.

        Raises:
            OSError: the file cannot be written.
        """
        if not self._is_copied:
            with self._damage_reported():
                self._flush_resampler()
                self._output.mux(self._stream.encode(None))

    def _decoded(self, packet: Packet[AudioStream]) -> list[AudioFrame]:
        try:
            return packet.decode()
        except av.FFmpegError as error:
            self.damage = damage_text(error)
            return []

    def _encode(self, frame: AudioFrame) -> None:
        if frame.pts is None or frame.time_base is None:
            return
        time_s = frame.pts * frame.time_base
        early = math.ceil((self._from_s - time_s) * frame.sample_rate)
        if 0 < early < frame.samples:
            frame, time_s = _without_first(frame, early), self._from_s
        if not self._is_next(time_s):
            return
        frame.pts = round((time_s - self._from_s) * frame.sample_rate)
        frame.time_base = Fraction(1, frame.sample_rate)
        with self._damage_reported():
            kind = frame.format.name, frame.layout.name, frame.sample_rate
            if kind != self._resampled:  # a resampler takes one kind only
                self._flush_resampler()
                context = self._stream.codec_context
                self._resampler = av.AudioResampler(
                    context.format, context.layout, context.sample_rate
                )
                self._resampled = kind
            self._mux_encoded(frame)

    def _flush_resampler(self) -> None:
        if self._resampler is not None:
            self._mux_encoded(None)

    def _mux_encoded(self, frame: AudioFrame | None) -> None:
        resampled = [] if self._resampler is None else self._resampler.resample(frame)
        for one in filter(None, resampled):
            self._output.mux(self._stream.encode(one))

    def _is_next(self, time_s: Fraction) -> bool:
        """Whether something of this time, in seconds of the source, follows what was written."""
        if time_s < self._from_s:
            return False
        if time_s <= self._last_s:  # streams were joined
            self.damage = self.damage or "its times go back"
            return False
        self._last_s = time_s
        return True

    @contextmanager
    def _damage_reported(self) -> Iterator[None]:
        """Report what is wrong with the audio; errors of the file that is written are raised."""
        try:
            yield
        except (av.FFmpegError, ValueError) as error:
            if isinstance(error, OSError):
                raise
            self.damage = damage_text(error)


def _without_first(frame: AudioFrame, count: int) -> AudioFrame:
    """A frame without its first samples; its time is the caller's to set."""
    width = 1 if frame.format.is_planar else frame.layout.nb_channels
    rest = av.AudioFrame.from_ndarray(
        cast("Any", np.ascontiguousarray(frame.to_ndarray()[:, count * width :])),
        frame.format.name,
        frame.layout.name,
    )
    rest.sample_rate = frame.sample_rate
    return rest


def damage_text(error: Exception) -> str:
    """What is wrong with audio, by an error of FFmpeg's or PyAV's."""
    return getattr(error, "strerror", None) or str(error)


def _can_copy(container: str, source: AudioStream) -> bool:
    """Whether a container takes audio as it is."""
    context = source.codec_context
    codec = context.codec.canonical_name  # the context's name is the decoder's, such as mp3float
    if (container, codec) == ("mp4", "mp3") and context.sample_rate < _MP4_MIN_MP3_HZ:
        return False  # MPEG-4 knows the rates of MPEG-1 and MPEG-2 only
    return codec in _COPY_CODECS[container]


def _supported_hz(container: str, wanted_hz: int) -> int:
    """The samples a second that the encoder of a container takes: those of the source, if any."""
    rates_hz = av.Codec(_ENCODERS[container], "w").audio_rates or ()
    return wanted_hz if container != _OPUS and wanted_hz in rates_hz else _USUAL_HZ
