"""Workers that process images and videos, and the engine that runs them in threads."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias, cast

from depthcli._version import __version__
from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import Intrinsics
from depthcli.core.parallel import one_thread_each, ordered_map
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.types import DepthMap, Frame, displayed_depth
from depthcli.core.validation import fingerprint
from depthcli.errors import InputError, ModelError, UsageError, about
from depthcli.inference.loading import SessionLoader
from depthcli.inference.measure import check_network
from depthcli.inference.pipeline import Pipeline, Prediction
from depthcli.inference.session import Session
from depthcli.io.depth.metadata import camera_text
from depthcli.io.formats.table import Format
from depthcli.io.images.read import read_image
from depthcli.io.listing.folder import is_archive
from depthcli.io.manifest.files import FAILED, OK, AnchorEntry, CacheKey, ManifestRow, output_entry
from depthcli.io.storage.atomic import Guard, atomic_path
from depthcli.io.storage.paths import local_copy, path_of, read_bytes
from depthcli.jobs.batch.tasks import BatchOptions, BatchResult, BatchTask
from depthcli.jobs.write import failure_reason, write_output, write_stream
from depthcli.video.formats import SEQUENCES, VideoFormat

if TYPE_CHECKING:
    from depthcli.io.archives import Member

ImageTask: TypeAlias = BatchTask[Format]


@dataclass(frozen=True, slots=True)
class _OpenedImage:
    """A picture that was read."""

    task: ImageTask
    frame: Frame
    guard: Guard
    points: AnchorPoints | None
    sha256: str
    seconds: float


@dataclass(frozen=True, slots=True)
class ImageWorker:
    """Processes pictures; thread-safe."""

    options: BatchOptions  #: how each picture is processed
    out: Path  #: the output folder
    key: CacheKey  #: model and options of the batch
    pipeline: Pipeline  #: the model

    def work(self, tasks: Sequence[ImageTask]) -> list[BatchResult]:
        """Process some pictures; the network runs on them as one batch.

        Raises:
            ModelError: the network fails on any picture.
            UsageError: the options do not fit the model, or outputs are those of other inputs.
        """
        opened = [self._open(task) for task in tasks]
        readable = [one for one in opened if isinstance(one, _OpenedImage)]
        start_s = time.perf_counter()
        predictions = iter(self._predictions(readable))
        share_s = (time.perf_counter() - start_s) / max(1, len(readable))
        return [
            self._finish(one, next(predictions), share_s) if isinstance(one, _OpenedImage) else one
            for one in opened
        ]

    def _open(self, task: ImageTask) -> _OpenedImage | BatchResult:
        start_s = time.perf_counter()
        sha256 = None
        try:
            data = read_bytes(task.input.readable_path())
            sha256 = hashlib.sha256(data).hexdigest()
            points = self.options.points_for(
                task.input, task.outputs.values(), shares_stem=task.shares_stem
            )
            row = task.reusable_row(self.out, sha256, self.key, points)
            if row is not None:
                return BatchResult(row, is_kept=True)
            guard = task.guard(overwrite=self.options.overwrite)
            frame = read_image(
                path_of(task.input.path),
                data,
                max_pixels=self.options.max_pixels,
                **self.options.reading._asdict(),
            )
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            return self._failed(task, error, start_s, sha256)
        seconds = time.perf_counter() - start_s
        return _OpenedImage(task, frame, guard, points, sha256, seconds)

    def _predictions(self, opened: Sequence[_OpenedImage]) -> list[Prediction | Exception]:
        return self.pipeline.predict_many(
            [one.frame for one in opened],
            [self.options.camera.of_image(one.task.intrinsics) for one in opened],
            [one.points for one in opened],
        )

    def _finish(
        self, opened: _OpenedImage, found: Prediction | Exception, share_s: float
    ) -> BatchResult:
        task = opened.task
        start_s = time.perf_counter() - opened.seconds - share_s
        if isinstance(found, Exception):
            check_network(found, self.pipeline.session)
            return self._failed(task, found, start_s, opened.sha256)
        depth = found.depth
        try:
            frame, points = opened.frame, opened.points
            warnings = [*frame.warnings, *found.warnings]
            for which, path in task.outputs.items():
                warnings += write_output(
                    self.options.writing, which, depth, frame, path, opened.guard
                )
            files = tuple(output_entry(self.out, path) for path in task.outputs.values())
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            return self._failed(task, error, start_s, opened.sha256)
        row = ManifestRow(
            input=task.input.name,
            status=OK,
            key=task.key(self.key),
            outputs=files,
            seconds=time.perf_counter() - start_s,
            input_sha256=opened.sha256,
            input_path=task.input_path,
            warnings=tuple(warnings),
            camera=camera_text(displayed_depth(depth, frame.windows)),
            anchors=anchor_entry(depth, points),
        )
        return BatchResult(row)

    def _failed(
        self, task: ImageTask, error: Exception, start_s: float, sha256: str | None
    ) -> BatchResult:
        if isinstance(error, UsageError):
            raise error
        return task.failed_result(error, self.key, start_s, sha256)


def anchor_entry(depth: DepthMap, points: AnchorPoints | None) -> AnchorEntry | None:
    """The entry of the known points that a map was fitted to; None if it was not."""
    fit = depth.provenance.anchor_fit if depth.provenance else None
    if fit is None or points is None:
        return None
    return AnchorEntry(fit.given, fit.used, round(fit.residual_m, 6), points.sha256())


VideoTask: TypeAlias = BatchTask[VideoFormat]


class _Files(NamedTuple):
    """The outputs of an image of an archive."""

    data: dict[Format, bytes]
    depth: DepthMap
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class VideoWorker:
    """Processes videos and archives of images."""

    images: ImageWorker  #: the worker for pictures, with the same model and options
    workers: int  #: frames processed in parallel
    progress: Progress  #: advanced for each frame

    def work(self, task: VideoTask | ImageTask) -> BatchResult:
        """Process one video, or one archive.

        Raises:
            ModelError: the network fails on any picture.
            UsageError: outputs are those of another video.
        """
        start_s = time.perf_counter()
        sha256 = None
        key = self.images.key
        try:
            with local_copy(task.input.readable_path()) as source:
                sha256 = video_checksum(task, source, self.images.options)
                row = task.reusable_row(self.images.out, sha256, key)
                if row is not None:
                    return BatchResult(row, is_kept=True)
                guard = task.guard(overwrite=self.images.options.overwrite)
                if is_archive(task.input.name):
                    images = cast("ImageTask", task)
                    return BatchResult(self._archive_row(images, source, sha256, guard))
                return BatchResult(self._row(cast("VideoTask", task), source, sha256))
        except UsageError:
            raise
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            check_network(error, self.images.pipeline.session)
            return task.failed_result(error, key, start_s, sha256)

    def _archive_row(self, task: ImageTask, source: Path, sha256: str, guard: Guard) -> ManifestRow:
        from depthcli.io.archives import archive_writer, members  # noqa: PLC0415 - seldom needed

        start_s, options = time.perf_counter(), self.images.options
        camera = options.camera.of_image(task.intrinsics)
        (path,) = task.outputs.values()
        failed, warned, first, count = [], [], None, 0
        stage = self.progress.begin(task.input.name, None, "images")

        def work(member: Member) -> tuple[Member, _Files | Exception]:
            try:
                return member, self._member_files(member, camera)
            except Exception as error:  # noqa: BLE001 - no image may stop the others
                check_network(error, self.images.pipeline.session)
                return member, error

        with (
            atomic_path(path, guard=guard) as temporary,
            archive_writer(temporary, options.formats) as write,
            closing(
                ordered_map(work, members(source, options.column), workers=self.workers)
            ) as done,
        ):
            for member, found in done:
                count += 1
                stage(1)
                if isinstance(found, Exception):
                    failed.append(about(member.name, failure_reason(found)))
                    write(member, {})
                    continue
                write(member, found.data)
                first = first or camera_text(found.depth)
                warned += [about(member.name, text) for text in found.warnings]
            if count == len(failed):
                raise InputError(failed[0] if failed else f"{source} holds no image")
        some = f"{len(failed)} of {count} images failed, the first: {failed[0]}" if failed else None
        return ManifestRow(
            input=task.input.name,
            status=FAILED if failed else OK,
            key=task.key(self.images.key),
            outputs=(output_entry(self.images.out, path),),
            seconds=time.perf_counter() - start_s,
            input_sha256=sha256,
            input_path=task.input_path,
            error=some,
            warnings=tuple(warned),
            camera=first,
        )

    def _member_files(self, member: Member, camera: Intrinsics) -> _Files:
        options, pipeline = self.images.options, self.images.pipeline
        if member.data is None:
            raise InputError("holds no image")
        frame = read_image(
            Path(member.name),
            member.data,
            max_pixels=options.max_pixels,
            **options.reading._asdict(),
        )
        depth, warnings = pipeline.predict(frame, camera)
        files = {}
        for which in options.formats:
            stream = BytesIO()
            warnings += write_stream(options.writing, which, depth, frame, stream)
            files[which] = stream.getvalue()
        return _Files(files, displayed_depth(depth, frame.windows), (*frame.warnings, *warnings))

    def _row(self, task: VideoTask, source: Path, sha256: str) -> ManifestRow:
        # PyAV takes 60 ms to load, which a batch of images does not need.
        from depthcli.jobs.video.plan import VideoPlan, VideoSettings  # noqa: PLC0415
        from depthcli.jobs.video.stages import write_video  # noqa: PLC0415

        options, out = self.images.options, self.images.out
        name = task.input.name
        names = {which: path.name for which, path in task.outputs.items()}
        overwrite = options.overwrite or task.is_listed
        folder = (out / name).parent
        plan = VideoPlan(name, source, folder, names, overwrite=overwrite, sha256=sha256)
        settings = VideoSettings(
            writing=options.writing,
            camera=options.camera.of_image(task.intrinsics),
            reading=options.reading,
            detail=options.detail,
            max_pixels=options.max_pixels,
        )
        done = write_video(plan, self.images.pipeline, settings, self.workers, self.progress)
        return ManifestRow(
            input=name,
            status=FAILED if done.problem else OK,
            key=task.key(self.images.key),
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


def _output_files(outputs: Mapping[VideoFormat, Path], numbers: Sequence[int]) -> Iterator[Path]:
    for which, path in outputs.items():
        if which not in SEQUENCES:
            yield path
            continue
        start, _, end = path.name.rpartition("%06d")
        for number in numbers:
            yield path.with_name(f"{start}{number:06d}{end}")


def video_checksum(task: VideoTask | ImageTask, path: Path, options: BatchOptions) -> str:
    """SHA-256 of a video or an archive, in constant memory.

    Raises:
        InputError: it cannot be processed, or the options do not apply to it.
    """
    kind = "an archive" if is_archive(task.input.name) else "a video"
    if not set(task.outputs) - {VideoFormat.JSON}:
        raise InputError(f"{path} is {kind}, which no format holds", "add {format} png16")
    if options.anchors:
        raise InputError(f"{path} is {kind}, to which anchors do not apply")
    if not path.is_file():
        raise InputError(f"{path} is missing, or no file")
    try:
        if not path.stat().st_size:  # also of /proc/kmsg, which could be read without end
            raise InputError(f"{path} is empty")
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None


@dataclass(frozen=True, slots=True)
class WorkerSpec:
    """Plain values, which can be pickled, that a worker is built from."""

    model: SessionLoader  #: model, provider and threads
    model_sha256: str  #: checksum of the model's file, 64 hex digits; another one is refused
    options: BatchOptions  #: how each input is processed
    out: Path  #: the output folder

    def build(self, session: Session | None = None) -> ImageWorker:
        """Build the worker in this process.

        Args:
            session: the model, if it is loaded already.

        Raises:
            ModelError: the model cannot be loaded here, or it is another one.
            ProviderError: the requested provider is not available.
        """
        session = session or self.model.load()
        if session.model.sha256 != self.model_sha256:
            raise ModelError(
                f"{session.model.path} is not the model that this batch began with "
                f"(sha256 {self.model_sha256})",
                "copy that one here",
            )
        pipeline = Pipeline(session, self.options.detail)
        return ImageWorker(self.options, self.out, self.key(session), pipeline)

    def key(self, session: Session) -> CacheKey:
        """Fingerprint of the options, model and version that outputs are made with."""
        loaded, options = session.model, self.options
        # Providers differ in the last digits; threads, workers and batch sizes do not. The card
        # matters as much as the weights, and is not part of their file.
        checksum = fingerprint(
            sorted(set(options.formats)),
            options.writing,
            options.camera,
            options.reading,
            options.detail,
            options.column,
            session.provider,
            self.model.provider_options,
            (loaded.card.input, loaded.card.output, loaded.card.camera),
        )
        return CacheKey(checksum, loaded.card.name, loaded.sha256, __version__)


class Engine(Protocol):
    """Workers in threads, in processes or on other machines."""

    def run(
        self,
        spec: WorkerSpec,
        chunks: Iterable[Sequence[ImageTask]],
        videos: Iterable[VideoTask | ImageTask],
        record: Callable[[Sequence[BatchResult]], None],
    ) -> Generator[BatchResult, None, None]:
        """Process chunks of pictures, and videos.

        Args:
            spec: each worker is built from it, where it runs.
            chunks: pictures that a worker processes together; consumed by the iterating thread.
            videos: consumed after the pictures.
            record: called with the results of a chunk in this process, from any thread, in any
                order, as soon as they are available; recorded results are safe.

        Yields:
            The results; with threads, in the order of the inputs. When the iterator is closed, all
            running work is stopped.

        Raises:
            ModelError: the network fails on any picture.
            UsageError: the options do not fit the model.
        """


_CHUNKS_AHEAD = 64
"""Chunks per worker that may be done ahead of a slow one; they hold names only."""


@dataclass(frozen=True, slots=True)
class ThreadEngine:
    """An :class:`Engine` of threads in this process, which share one model."""

    workers: int  #: chunks processed in parallel
    session: Session | None = None  #: the model, if it is loaded already
    progress: Progress = NO_PROGRESS  #: advanced for each frame of a video

    def run(
        self,
        spec: WorkerSpec,
        chunks: Iterable[Sequence[ImageTask]],
        videos: Iterable[VideoTask | ImageTask],
        record: Callable[[Sequence[BatchResult]], None],
    ) -> Generator[BatchResult, None, None]:
        """Process images, then videos one after another."""
        worker = spec.build(self.session)

        def work(chunk: Sequence[ImageTask]) -> list[BatchResult]:
            results = worker.work(chunk)
            record(results)
            return results

        ahead = _CHUNKS_AHEAD * self.workers
        with (
            one_thread_each(self.workers),
            closing(ordered_map(work, chunks, workers=self.workers, ahead=ahead)) as done,
        ):
            for results in done:
                yield from results
        for task in videos:
            result = VideoWorker(worker, self.workers, self.progress).work(task)
            record((result,))
            yield result
