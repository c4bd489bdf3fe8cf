"""What a video's depth is written to: one lossless file, a preview, or a file for each frame."""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from depthcli.errors import OutputError
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.video.codecs import Codec
from depthcli.io.video.depth import LABEL_PREFIX
from depthcli.io.video.file import VideoFile, coded
from depthcli.io.video.rates import rate_text
from depthcli.io.writers.facts import facts, step_unit
from depthcli.io.writers.png16 import quantized

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    import numpy.typing as npt
    from av.video.frame import VideoFrame

    from depthcli.core.types import DepthMap, Frame
    from depthcli.io.video.rates import Timing
    from depthcli.io.video.sound import Sound
    from depthcli.io.writers.base import Writer
    from depthcli.io.writers.preview import PreviewWriter

_TOP = 65535


class Shot(NamedTuple):
    """One frame, ready to be written.

    Attributes:
        frame: the picture.
        depth: its depth.
        spread: low and high end of the preview's range.
        is_kept: whether an earlier run wrote it.
    """

    frame: Frame
    depth: DepthMap
    spread: tuple[float, float]
    is_kept: bool = False

    @property
    def time_s(self) -> float:
        """When the frame is shown."""
        return self.frame.timestamp_s or 0.0


class VideoOutput(Protocol):
    """One output of a video."""

    def encode(self, shot: Shot) -> Any:  # noqa: ANN401 - each output has its own
        """The part of the work that any thread can do, for any frame."""
        ...

    def append(self, encoded: Any) -> None:  # noqa: ANN401
        """The part that is done frame after frame."""
        ...

    def finish(self) -> tuple[str, ...]:
        """Complete the output.

        Returns:
            Warnings, one line each.
        """
        ...


class DepthVideoOutput:
    """Lossless 16-bit gray: steps of depth, 0 = no depth, saturating."""

    def __init__(self, file: VideoFile, timing: Timing, scale: float) -> None:
        self._file = file
        self._timing = timing
        self._scale = scale
        self._saturated = 0
        self._first: Shot | None = None

    def encode(self, shot: Shot) -> tuple[Shot, VideoFrame, int]:
        """Depth in whole steps, and how many pixels were saturated."""
        if shot.depth.is_metric:
            steps, saturated = quantized(shot.depth.values, self._scale)
        else:
            steps, saturated = within(shot.depth.values, *shot.spread), 0
        return shot, coded(steps, Codec.FFV1), saturated

    def append(self, encoded: tuple[Shot, VideoFrame, int]) -> None:
        """Write the steps; with the first ones, labels with rate, scale, unit and model."""
        shot, frame, saturated = encoded
        labels = {} if self._first else self._labels(shot)
        self._first = self._first or shot
        self._saturated += saturated
        self._file.write(frame, shot.time_s, labels)

    def finish(self) -> tuple[str, ...]:
        """Complete the file."""
        self._file.finish()
        if self._first is not None and not self._first.depth.is_metric:
            kind = self._first.depth.kind
            return (f"{kind} depth has no unit; mkv is normalized to the preview's range",)
        if not self._saturated:
            return ()
        limit_m = _TOP / self._scale
        return (f"mkv: {self._saturated} pixels beyond {limit_m:.6g} m were saturated",)

    def _labels(self, shot: Shot) -> dict[str, str]:
        labels = facts(shot.depth) | {
            "frame_rate": rate_text(self._timing.rate),
            "first_frame": str(shot.frame.index),
        }
        if shot.depth.is_metric:
            labels |= {"scale": f"{self._scale:g}", "unit": step_unit(self._scale)}
        else:
            labels |= {"scale": "normalized"}
        return {f"{LABEL_PREFIX}{name.upper()}": text for name, text in labels.items()}


class PreviewVideoOutput:
    """Colours for people, in a range that is held steady."""

    def __init__(self, file: VideoFile, codec: Codec, writer: PreviewWriter) -> None:
        self._file = file
        self._codec = codec
        self._writer = writer

    def encode(self, shot: Shot) -> tuple[VideoFrame, float]:
        """The preview of a frame."""
        pixels = self._writer.render(shot.depth, shot.frame, shot.spread)
        return coded(pixels, self._codec), shot.time_s

    def append(self, encoded: tuple[VideoFrame, float]) -> None:
        """Write it."""
        self._file.write(*encoded, {})

    def finish(self) -> tuple[str, ...]:
        """Complete the file, with its sound."""
        return self._file.finish()


class SequenceOutput:
    """A file for each frame, in one of the formats of pictures; each appears when it is done."""

    def __init__(
        self,
        label: str,
        folder: Path,
        name: Callable[[int], str],
        writer: Writer,
        inputs: Sequence[Path],
    ) -> None:
        """Name where frames go.

        Args:
            label: what warnings call the format.
            folder: of the files.
            name: gives a file's name for a frame's number.
            writer: of each file.
            inputs: files that must not be replaced.
        """
        self._label = label
        self._folder = folder
        self._name = name
        self._writer = writer
        self._inputs = frozenset(os.path.realpath(path) for path in inputs)
        self._warned = 0
        self._warning = ""

    def encode(self, shot: Shot) -> tuple[str, ...]:
        """Write the file; the order of files does not matter."""
        if shot.is_kept:
            return ()
        path = self._folder / self._name(shot.frame.index)
        if os.path.realpath(path) in self._inputs:
            raise OutputError(f"{path} is an input and is not overwritten; choose another --out")
        with atomic_path(path) as temporary:
            return self._writer.write(shot.depth, temporary, shot.frame)

    def append(self, encoded: tuple[str, ...]) -> None:
        """Remember the first warning, and count them."""
        if encoded:
            self._warning = self._warning or encoded[0]
            self._warned += 1

    def finish(self) -> tuple[str, ...]:
        """Say the first warning once."""
        if not self._warned:
            return ()
        return (f"{self._label}: {self._warned} frames, the first: {self._warning}",)


@contextmanager
def depth_video(
    path: Path, timing: Timing, scale: float, inputs: Sequence[Path]
) -> Iterator[VideoOutput]:
    """A lossless depth video that appears whole or not at all.

    Args:
        path: ends in ``.mkv``.
        timing: of the frames.
        scale: steps per metre.
        inputs: files that must not be replaced.
    """
    with _video_file(path, Codec.FFV1, timing, inputs) as file:
        yield DepthVideoOutput(file, timing, scale)


@contextmanager
def preview_video(
    path: Path,
    timing: Timing,
    writer: PreviewWriter,
    inputs: Sequence[Path],
    *,
    codec: Codec = Codec.H264,
    sound: Sound | None = None,
) -> Iterator[VideoOutput]:
    """A preview that appears whole or not at all.

    Args:
        path: ends in ``.mp4``, ``.webm`` or ``.mov``.
        timing: of the frames.
        writer: of the colours.
        inputs: files that must not be replaced.
        codec: one that the container holds.
        sound: what is heard.
    """
    with _video_file(path, codec, timing, inputs, sound) as file:
        yield PreviewVideoOutput(file, codec, writer)


def within(values: npt.NDArray[np.float32], low: float, high: float) -> npt.NDArray[np.uint16]:
    """Values of a range as 1-65535, those beyond at its ends; 0 where there is none.

    (H, W) float32 in, (H, W) uint16 out.
    """
    share = (np.nan_to_num(values, nan=low) - low) / ((high - low) or 1.0)
    steps = np.rint(1 + np.clip(share, 0, 1) * (_TOP - 1))
    return np.where(np.isnan(values), 0, steps).astype(np.uint16)


@contextmanager
def _video_file(
    path: Path, codec: Codec, timing: Timing, inputs: Sequence[Path], sound: Sound | None = None
) -> Iterator[VideoFile]:
    with atomic_path(path, inputs=inputs) as temporary:
        file = VideoFile(temporary, codec, timing, sound)
        try:
            yield file
        finally:
            file.close()
