"""What a video's depth is written to: one lossless file, a preview, or a file for each frame."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from depthcli.errors import OutputError
from depthcli.io.atomic import atomic_path
from depthcli.io.atomic_sequence import atomic_sequence
from depthcli.io.writers.facts import facts, step_unit
from depthcli.io.writers.png16 import quantized
from depthcli.io.writers.video_file import Codec, VideoFile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from fractions import Fraction
    from pathlib import Path

    import numpy.typing as npt

    from depthcli.core.types import DepthMap, Frame
    from depthcli.io.writers.base import Writer
    from depthcli.io.writers.preview import PreviewWriter

_TOP = 65535


class Shot(NamedTuple):
    """One frame, ready to be written.

    Attributes:
        frame: the picture.
        depth: its depth.
        spread: low and high end of the preview's range.
    """

    frame: Frame
    depth: DepthMap
    spread: tuple[float, float]


class VideoOutput(Protocol):
    """One output of a video."""

    def encode(self, shot: Shot) -> Any:  # noqa: ANN401 - each output has its own
        """The part of the work that any thread can do, for any frame."""
        ...

    def append(self, encoded: Any) -> None:  # noqa: ANN401
        """The part that is done frame after frame."""
        ...

    def finish(self, times_s: Sequence[float]) -> tuple[str, ...]:
        """Complete the output; frames' times count from the first.

        Returns:
            Warnings, one line each.
        """
        ...


class DepthVideoOutput:
    """Lossless 16-bit gray: steps of depth, 0 = no depth, saturating."""

    def __init__(self, file: VideoFile, rate: Fraction, scale: float) -> None:
        self._file = file
        self._rate = rate
        self._scale = scale
        self._saturated = 0
        self._first: Shot | None = None

    def encode(self, shot: Shot) -> tuple[Shot, npt.NDArray[np.uint16], int]:
        """Depth in whole steps, and how many pixels were saturated."""
        if shot.depth.is_metric:
            return shot, *quantized(shot.depth.values, self._scale)
        return shot, within(shot.depth.values, *shot.spread), 0

    def append(self, encoded: tuple[Shot, npt.NDArray[np.uint16], int]) -> None:
        """Write the steps."""
        shot, steps, saturated = encoded
        self._first = self._first or shot
        self._saturated += saturated
        self._file.write(steps)

    def finish(self, times_s: Sequence[float]) -> tuple[str, ...]:
        """Exact times, and labels with rate, scale, unit and model."""
        if self._first is None:
            return ()
        depth = self._first.depth
        labels = facts(depth) | {
            "frame_rate": f"{self._rate.numerator}/{self._rate.denominator}",
            "first_frame": str(self._first.frame.index),
        }
        if not depth.is_metric:
            self._file.finish(times_s, labels | {"scale": "normalized"})
            return (f"{depth.kind} depth has no unit; mkv is normalized to the preview's range",)
        scale = f"{self._scale:g}"
        self._file.finish(times_s, labels | {"scale": scale, "unit": step_unit(self._scale)})
        if not self._saturated:
            return ()
        limit_m = _TOP / self._scale
        return (f"mkv: {self._saturated} pixels beyond {limit_m:.6g} m were saturated",)


class PreviewVideoOutput:
    """Colours for people, in a range that is held steady."""

    def __init__(self, file: VideoFile, writer: PreviewWriter) -> None:
        self._file = file
        self._writer = writer

    def encode(self, shot: Shot) -> npt.NDArray[np.uint8]:
        """The preview of a frame."""
        return self._writer.render(shot.depth, shot.frame, shot.spread)

    def append(self, encoded: npt.NDArray[np.uint8]) -> None:
        """Write it."""
        self._file.write(encoded)

    def finish(self, times_s: Sequence[float]) -> tuple[str, ...]:
        """Exact times."""
        self._file.finish(times_s, {})
        return ()


class SequenceOutput:
    """A file for each frame, in one of the formats of pictures."""

    def __init__(self, folder: Path, name: Callable[[int], str], writer: Writer) -> None:
        self._folder = folder
        self._name = name
        self._writer = writer
        self._warned = 0
        self._warning = ""

    def encode(self, shot: Shot) -> tuple[str, ...]:
        """Write the file; the order of files does not matter."""
        path = self._folder / self._name(shot.frame.index)
        try:
            return self._writer.write(shot.depth, path, shot.frame)
        except OSError as error:
            reason = error.strerror or str(error)
            folder = self._folder.parent
            raise OutputError(
                f"cannot write into {folder}: {reason}; choose another --out"
            ) from error

    def append(self, encoded: tuple[str, ...]) -> None:
        """Remember the first warning, and count them."""
        if encoded:
            self._warning = self._warning or encoded[0]
            self._warned += 1

    def finish(self, times_s: Sequence[float]) -> tuple[str, ...]:
        """Say the first warning once."""
        del times_s
        if not self._warned:
            return ()
        return (f"{self._writer.NAME}: {self._warned} frames, the first: {self._warning}",)


@contextmanager
def depth_video(
    path: Path, rate: Fraction, scale: float, inputs: Sequence[Path]
) -> Iterator[VideoOutput]:
    """A lossless depth video that appears whole or not at all.

    Args:
        path: ends in ``.mkv``.
        rate: frames a second.
        scale: steps per metre.
        inputs: files that must not be replaced.
    """
    with _video_file(path, Codec.FFV1, rate, inputs) as file:
        yield DepthVideoOutput(file, rate, scale)


@contextmanager
def preview_video(
    path: Path, rate: Fraction, writer: PreviewWriter, inputs: Sequence[Path]
) -> Iterator[VideoOutput]:
    """A preview that appears whole or not at all; ``path`` ends in ``.mp4``."""
    with _video_file(path, Codec.MPEG4, rate, inputs) as file:
        yield PreviewVideoOutput(file, writer)


@contextmanager
def frame_sequence(
    folder: Path, name: Callable[[int], str], writer: Writer, inputs: Sequence[Path]
) -> Iterator[VideoOutput]:
    """Files, one for each frame, that appear together or not at all.

    Args:
        folder: of the files.
        name: gives a file's name for a frame's number.
        writer: of each file.
        inputs: files that must not be replaced.
    """
    with atomic_sequence(folder, inputs=inputs) as temporary:
        yield SequenceOutput(temporary, name, writer)


def within(values: npt.NDArray[np.float32], low: float, high: float) -> npt.NDArray[np.uint16]:
    """Values of a range as 1-65535, those beyond at its ends; 0 where there is none.

    (H, W) float32 in, (H, W) uint16 out.
    """
    share = (np.nan_to_num(values, nan=low) - low) / ((high - low) or 1.0)
    steps = np.rint(1 + np.clip(share, 0, 1) * (_TOP - 1))
    return np.where(np.isnan(values), 0, steps).astype(np.uint16)


@contextmanager
def _video_file(
    path: Path, codec: Codec, rate: Fraction, inputs: Sequence[Path]
) -> Iterator[VideoFile]:
    with atomic_path(path, inputs=inputs) as temporary:
        file = VideoFile(temporary, codec, rate)
        try:
            yield file
        finally:
            file.close()
