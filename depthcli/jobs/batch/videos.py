"""The videos of a batch, one after another; each keeps all cores busy by itself."""

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from depthcli.core.camera import Camera
from depthcli.core.progress import Progress
from depthcli.errors import InputError
from depthcli.io.manifest.row import FAILED, OK, Row, written
from depthcli.io.storage.remote import path_of
from depthcli.io.storage.transfer import local_copy
from depthcli.io.writers.facts import camera_words
from depthcli.jobs.batch.pictures import PictureWorker
from depthcli.jobs.batch.suspects import check_video
from depthcli.jobs.batch.task import Result, Task, check_network
from depthcli.jobs.video.plan import VideoPlan
from depthcli.jobs.video.request import VideoSettings
from depthcli.jobs.video.write import write_video
from depthcli.video.formats import SEQUENCES, VideoFormat

VideoTask: TypeAlias = Task[VideoFormat]


@dataclass(frozen=True, slots=True)
class VideoWorker:
    """Does videos."""

    pictures: PictureWorker  #: the worker that does pictures with the same model and options
    workers: int  #: frames at the same time
    progress: Progress  #: told of each frame

    def work(self, task: VideoTask) -> Result:
        """Do one video.

        Raises:
            ModelError: the network fails on any picture.
        """
        start_s = time.perf_counter()
        sha256 = None
        origin = self.pictures.origin
        try:
            with local_copy(path_of(task.input.path)) as source:
                before = _identity_of(source)
                sha256 = checked_video(task, source, self.pictures.options.camera)
                row = task.kept(self.pictures.out, sha256, origin)
                if row is not None:
                    return Result(row, is_kept=True)
                if task.is_suspect:
                    check_video(task.input.path, source)
                done = self._row(task, source, sha256)
                _check_unchanged(source, before)
                return Result(done)
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            check_network(error, self.pictures.pipeline.session)
            return task.failed(error, origin, start_s, sha256)

    def _row(self, task: VideoTask, source: Path, sha256: str) -> Row:
        options, out = self.pictures.options, self.pictures.out
        name = task.input.name
        names = {which: path.name for which, path in task.outputs.items()}
        plan = VideoPlan(name, source, (out / name).parent, names)
        settings = VideoSettings(
            writing=options.writing,
            camera=options.camera,
            detail=options.detail,
            max_pixels=options.max_pixels,
        )
        done = write_video(plan, self.pictures.pipeline, settings, self.workers, self.progress)
        return Row(
            input=name,
            status=FAILED if done.problem else OK,
            origin=self.pictures.origin,
            outputs=tuple(written(out, path) for path in _output_files(task.outputs, done.numbers)),
            seconds=done.seconds,
            input_sha256=sha256,
            error=done.problem,
            warnings=done.warnings,
            camera=camera_words(done.depth),
        )


def _identity_of(path: Path) -> tuple[int, int, int] | None:
    """What changes when somebody writes to a file or replaces it; None if it cannot be read."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def _check_unchanged(path: Path, before: tuple[int, int, int] | None) -> None:
    if _identity_of(path) != before:
        raise InputError(f"{path} changed while it was read; run the batch again")


def _output_files(outputs: Mapping[VideoFormat, Path], numbers: Sequence[int]) -> Iterator[Path]:
    for which, path in outputs.items():
        if which not in SEQUENCES:
            yield path
            continue
        start, _, end = path.name.rpartition("%06d")
        for number in numbers:
            yield path.with_name(f"{start}{number:06d}{end}")


def checked_video(task: VideoTask, path: Path, camera: Camera) -> str:
    """Checksum of a video, which may not fit into memory.

    Raises:
        InputError: it cannot be read, or the options do not apply to videos.
    """
    if not set(task.outputs) - {VideoFormat.JSON}:
        raise InputError(f"{path} is a video, which this format cannot hold; add --format png16")
    if camera.anchors:
        raise InputError(f"{path} is a video, to which --anchor does not apply")
    if not path.is_file():
        raise InputError(f"{path} is missing, or no file")
    try:
        if not path.stat().st_size:  # nor has /proc/kmsg, which never ends
            raise InputError(f"{path} is empty")
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
