"""The videos of a batch, one after another; each keeps all cores busy by itself."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from depthcli.errors import InputError
from depthcli.io.video.formats import SEQUENCES, VideoFormat
from depthcli.jobs.batch.manifest import FAILED, OK, Row, written
from depthcli.jobs.batch.pictures import Result, blame, reason
from depthcli.jobs.video.plan import VideoJob
from depthcli.jobs.video.run import run_video
from depthcli.jobs.video.stages import VideoSettings

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.listing.folder import Found
    from depthcli.jobs.batch.journal import Journal
    from depthcli.jobs.batch.recipe import Targets


class VideoWorker(NamedTuple):
    """Does videos.

    Attributes:
        targets: the outputs to make.
        pipeline: the model.
        journal: where rows go.
        workers: frames at the same time.
    """

    targets: Targets
    pipeline: Pipeline
    journal: Journal
    workers: int

    def work(self, found: Found) -> Result:
        """Do one video.

        Raises:
            ModelError: the network fails on any picture.
            OutputError: the journal cannot be written.
        """
        start = time.perf_counter()
        sha256 = None
        try:
            sha256 = checked_video(found, self.targets)
            kept = self.targets.kept(found, sha256)
            if kept is not None:
                return Result(kept, is_kept=True)
            row = self._row(found, sha256)
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            blame(error, self.pipeline)
            row = Row(
                input=found.name,
                status=FAILED,
                origin=self.targets.origin,
                seconds=time.perf_counter() - start,
                input_sha256=sha256,
                error=reason(error),
            )
        self.journal.add(row)
        return Result(row, is_kept=False)

    def _row(self, found: Found, sha256: str) -> Row:
        recipe, outputs = self.targets.recipe, self.targets.of_video(found)
        folder = (self.targets.plan.out / found.name).parent
        job = VideoJob(
            found.name, Path(found.path), folder, {w: p.name for w, p in outputs.items()}
        )
        settings = VideoSettings(
            looks=recipe.looks,
            workers=self.workers,
            focal_px=recipe.camera.focal_px,
            hfov_deg=recipe.camera.hfov_deg,
            limit=recipe.limit,
        )
        done = run_video(job, self.pipeline, settings)
        files = tuple(
            written(self.targets.plan.out, path) for path in _files(outputs, done.numbers)
        )
        return Row(
            input=found.name,
            status=FAILED if done.problem else OK,
            origin=self.targets.origin,
            outputs=files,
            seconds=done.seconds,
            input_sha256=sha256,
            error=done.problem,
            warnings=done.warnings,
        )


def _files(outputs: dict[VideoFormat, Path], numbers: Sequence[int]) -> Iterator[Path]:
    for which, path in outputs.items():
        if which not in SEQUENCES:
            yield path
            continue
        start, _, end = path.name.rpartition("%06d")
        for number in numbers:
            yield path.with_name(f"{start}{number:06d}{end}")


def checked_video(found: Found, targets: Targets) -> str:
    """Checksum of a video, which may not fit into memory.

    Raises:
        InputError: it cannot be read, or the options do not apply to videos.
    """
    path = Path(found.path)
    if not set(targets.of_video(found)) - {VideoFormat.JSON}:
        raise InputError(f"{path} is a video, which this format cannot hold; add --format png16")
    if targets.recipe.camera.anchors:
        raise InputError(f"{path} is a video, to which --anchor does not apply")
    if not path.is_file():
        raise InputError(f"{path} is missing, or no file")
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
