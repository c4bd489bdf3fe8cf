"""Processing videos in a worker, one after another; each uses all cores."""

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from depthcli.core.progress import Progress
from depthcli.errors import InputError, UsageError
from depthcli.inference.trial import check_network
from depthcli.io.formats.metadata import camera_text
from depthcli.io.manifest.row import FAILED, OK, Row, output_entry
from depthcli.io.storage.transfer import local_copy
from depthcli.jobs.batch.options import BatchOptions
from depthcli.jobs.batch.pictures import PictureWorker
from depthcli.jobs.batch.suspects import check_video
from depthcli.jobs.batch.task import Result, Task
from depthcli.jobs.video.plan import VideoPlan
from depthcli.jobs.video.request import VideoSettings
from depthcli.jobs.video.write import write_video
from depthcli.video.formats import SEQUENCES, VideoFormat

VideoTask: TypeAlias = Task[VideoFormat]


@dataclass(frozen=True, slots=True)
class VideoWorker:
    """Processes videos."""

    pictures: PictureWorker  #: the worker for pictures, with the same model and options
    workers: int  #: frames processed in parallel
    progress: Progress  #: advanced for each frame

    def work(self, task: VideoTask) -> Result:
        """Process one video.

        Raises:
            ModelError: the network fails on any picture.
            UsageError: outputs are those of another video.
        """
        start_s = time.perf_counter()
        sha256 = None
        origin = self.pictures.origin
        try:
            with local_copy(task.input.readable_path()) as source:
                before = _file_identity(source)
                sha256 = video_checksum(task, source, self.pictures.options)
                row = task.reusable_row(self.pictures.out, sha256, origin)
                if row is not None:
                    return Result(row, is_kept=True)
                task.guard(overwrite=self.pictures.options.overwrite)
                if task.is_suspect:
                    check_video(task.input.path, source)
                done = self._row(task, source, sha256)
                _check_unchanged(source, before)
                return Result(done)
        except UsageError:
            raise
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            check_network(error, self.pictures.pipeline.session)
            return task.failed_result(error, origin, start_s, sha256)

    def _row(self, task: VideoTask, source: Path, sha256: str) -> Row:
        options, out = self.pictures.options, self.pictures.out
        name = task.input.name
        names = {which: path.name for which, path in task.outputs.items()}
        overwrite = options.overwrite or task.is_listed
        folder = (out / name).parent
        plan = VideoPlan(name, source, folder, names, overwrite=overwrite, sha256=sha256)
        settings = VideoSettings(
            writing=options.writing,
            camera=options.camera.of_image(task.lens),
            reading=options.reading,
            detail=options.detail,
            max_pixels=options.max_pixels,
        )
        done = write_video(plan, self.pictures.pipeline, settings, self.workers, self.progress)
        return Row(
            input=name,
            status=FAILED if done.problem else OK,
            origin=task.origin(self.pictures.origin),
            outputs=tuple(
                output_entry(out, path) for path in _output_files(task.outputs, done.numbers)
            ),
            seconds=done.seconds,
            input_sha256=sha256,
            input_path=task.input_path,
            error=done.problem,
            warnings=done.warnings,
            camera=camera_text(done.depth),
        )


def _file_identity(path: Path) -> tuple[int, int, int] | None:
    """Inode, size and modification time of a file; None if it cannot be read."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def _check_unchanged(path: Path, before: tuple[int, int, int] | None) -> None:
    if _file_identity(path) != before:
        raise InputError(f"{path} changed while it was read; run the batch again")


def _output_files(outputs: Mapping[VideoFormat, Path], numbers: Sequence[int]) -> Iterator[Path]:
    for which, path in outputs.items():
        if which not in SEQUENCES:
            yield path
            continue
        start, _, end = path.name.rpartition("%06d")
        for number in numbers:
            yield path.with_name(f"{start}{number:06d}{end}")


def video_checksum(task: VideoTask, path: Path, options: BatchOptions) -> str:
    """SHA-256 of a video, in constant memory.

    Raises:
        InputError: it cannot be processed, or the options do not apply to videos.
    """
    if not set(task.outputs) - {VideoFormat.JSON}:
        raise InputError(
            f"{path} is a video, and no format in --format holds one; add --format png16"
        )
    if options.anchors:
        word = "--anchor" if isinstance(options.anchors, tuple) else "--anchors"
        raise InputError(f"{path} is a video, to which {word} does not apply")
    if not path.is_file():
        raise InputError(f"{path} is missing, or no file")
    try:
        if not path.stat().st_size:  # also of /proc/kmsg, which could be read without end
            raise InputError(f"{path} is empty")
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
