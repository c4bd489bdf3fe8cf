"""The request and the options of a batch."""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Self

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import UNKNOWN_CAMERA, Anchor, Intrinsics
from depthcli.core.options import AS_STATED, DEFAULT_DETAIL, MAX_PIXELS, Detail, ReadOptions
from depthcli.errors import InputError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.depth.anchors import AnchorFiles
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.listing.folder import InputFile
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.paths import path_of
from depthcli.jobs.batch.plan import BatchPlan

if TYPE_CHECKING:
    from depthcli.jobs.batch.tasks import BatchResult


class Tally:
    """Counts of results.

    Attributes:
        total: number of inputs.
        done: inputs that were processed, including the failed ones.
        kept: inputs whose outputs of an earlier run are still valid.
        failures: name and reason of those that failed.
        recent_failed: whether each of the last hundred processed inputs failed.
    """

    def __init__(self, total: int) -> None:
        self.total = total
        self.done = 0
        self.kept = 0
        self.failures: list[tuple[str, str]] = []
        self.recent_failed: deque[bool] = deque(maxlen=100)
        self._start_s = time.monotonic()

    def add(self, result: BatchResult) -> None:
        """Count a result."""
        self.kept += result.is_kept
        self.done += not result.is_kept
        if not result.is_kept:
            self.recent_failed.append(result.row.error is not None)
        if result.row.error is not None:
            self.failures.append((result.row.input, result.row.error))

    @property
    def completed(self) -> int:
        """Inputs that are done or kept."""
        return self.done + self.kept

    @property
    def elapsed_s(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._start_s

    @property
    def rate(self) -> float:
        """Inputs per second, without those kept."""
        return self.done / max(self.elapsed_s, 1e-9)


@dataclass(frozen=True, slots=True)
class FailureBudget:
    """Allowed failures: among all inputs, or as a percentage of the last hundred processed ones.

    The percentage is of a hundred from the first input on: missing ones count as successful. So a
    run that fails from the start stops as soon as one that starts to fail after days.
    """

    maximum: int
    is_percentage: bool = False

    @classmethod
    def parse(cls, word: str) -> Self:
        """Parse ``20`` or ``20%``.

        Raises:
            UsageError: it is neither, or more than 100%.
        """
        found = re.fullmatch(r"([0-9]{1,9})(%?)", word)
        if found is None or (found[2] and int(found[1]) > 100):  # noqa: PLR2004 - per cent
            raise UsageError(
                f"{word} is not a number or a percentage, such as 20 or 5%", option="max_failures"
            )
        return cls(int(found[1]), bool(found[2]))

    def reason(self, tally: Tally) -> str | None:
        """Why a batch has to stop; None if it may continue."""
        if (
            sum(tally.recent_failed) if self.is_percentage else len(tally.failures)
        ) <= self.maximum:
            return None
        plain = "1 input" if self.maximum == 1 else f"{self.maximum} inputs"
        which = f"{self.maximum}% of the last 100 inputs" if self.is_percentage else plain
        return f"more than {which} failed"


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """Options of processing an input."""

    formats: tuple[Format, ...] = (Format.PNG16,)  #: output formats, each once
    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the formats
    camera: Intrinsics = UNKNOWN_CAMERA  #: what is known of the camera
    #: points of known depth, or a folder with a file of them for each image
    anchors: AnchorFiles | tuple[Anchor, ...] = ()
    reading: ReadOptions = AS_STATED  #: how images are read
    detail: Detail = DEFAULT_DETAIL  #: upsampling and tiles
    max_pixels: int = MAX_PIXELS  #: larger pictures are refused
    overwrite: bool = False  #: whether outputs may replace files of other programs

    def points_for(
        self, picture: InputFile, outputs: Iterable[Path], *, shares_stem: bool
    ) -> AnchorPoints | None:
        """The known depth of a picture; None if there is none for any.

        Args:
            picture: the picture.
            outputs: its outputs, which must not replace the known depth.
            shares_stem: whether another picture has the same name but for its suffix.

        Raises:
            InputError: that of this picture is missing, cannot be read, or would be replaced.
        """
        if isinstance(self.anchors, AnchorFiles):
            path = path_of(picture.path)
            file = self.anchors.file_for(picture.name, shares_stem=shares_stem, picture=path)
            if any(is_same_file(output, file) for output in outputs):
                raise InputError(f"{file} is its known depth", "choose another {out}")
            return self.anchors.read_file(file)
        return AnchorPoints.of(self.anchors) if self.anchors else None


@dataclass(frozen=True, slots=True)
class BatchRequest:
    """A batch."""

    plan: BatchPlan  #: inputs, and the names of their outputs
    #: how each input is processed
    options: BatchOptions = field(default_factory=BatchOptions)
    #: model, provider and threads; by default, threads per worker are cores / workers
    model: SessionLoader = field(default_factory=SessionLoader)
    #: pictures, or chunks of them, processed in parallel; None for one per core
    workers: int | None = None
    #: pictures per inference; None for the provider's default
    batch_size: int | None = None
    budget: FailureBudget | None = None  #: failures after which it stops; None for no limit
