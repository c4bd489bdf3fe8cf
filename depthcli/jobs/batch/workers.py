"""Workers that process images and videos, and the engine of threads and processes for them.

Threads of one process wait for Python's lock, so that many images on many cores are divided among
processes of four threads: with 16 cores, 273 images/s in place of 110 (docs/performance.md).
"""

from __future__ import annotations

import hashlib
import multiprocessing
import signal
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, TypeAlias

from depthcli._version import __version__
from depthcli.core import parallel, validation
from depthcli.core.camera import Intrinsics
from depthcli.core.options import MILLIMETRES
from depthcli.errors import EngineError, InputError, ModelError, about, os_errors_as
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline, check_network
from depthcli.inference.session import Session
from depthcli.io.formats.table import Format
from depthcli.io.manifest import CacheKey, KnownDepthEntry, output_entry
from depthcli.io.media import is_archive, is_bag
from depthcli.io.storage import atomic, paths
from depthcli.io.stored.metadata import camera_text
from depthcli.jobs.batch.tasks import BatchOptions, BatchResult, BatchTask
from depthcli.jobs.image import ImageJob, ImageResult, ImageTask, failure_reason
from depthcli.video.formats import SEQUENCES, VideoFormat
from depthcli.video.numbering import numbered_name

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from depthcli.io.archives import Member

_Files: TypeAlias = tuple[dict[Format, bytes], str | None, tuple[str, ...]]
"""Outputs of an image of an archive, its camera as text, and warnings."""


class _OpenedImage(NamedTuple):
    task: BatchTask
    image: ImageTask
    sha256: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Worker:
    """Processes images, videos and archives of images; thread-safe."""

    options: BatchOptions  #: how each image is processed
    out: Path  #: the output folder
    key: CacheKey  #: model and options of the batch
    job: ImageJob  #: the model

    def work(self, tasks: Sequence[BatchTask]) -> list[BatchResult]:
        """Process some images; the network runs on them as one batch.

        ModelError if it fails on any image, UsageError if the options do not fit the model.
        """
        opened = [self._open(task) for task in tasks]
        readable = [each for each in opened if isinstance(each, _OpenedImage)]
        start_s = time.perf_counter()
        done = iter(self.job.run_many([each.image for each in readable]))
        share_s = (time.perf_counter() - start_s) / max(1, len(readable))
        return [
            self._result(each, next(done), share_s) if isinstance(each, _OpenedImage) else each
            for each in opened
        ]

    def _open(self, task: BatchTask) -> _OpenedImage | BatchResult:
        start_s, sha256 = time.perf_counter(), None
        try:
            data = paths.read_bytes(task.input.readable_path())
            sha256 = hashlib.sha256(data).hexdigest()
            points = self.options.points_for(task)
            row = task.reusable_row(self.out, sha256, self.key, points)
            if row is not None:
                return BatchResult(row, is_kept=True)
            task.check_outputs(overwrite=self.options.overwrite)
            frame = self.options.read(paths.path_of(task.input.path), data)
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            return task.failed_result(error, self.key, start_s, sha256)
        camera = self.options.camera.of_image(task.intrinsics)
        image = ImageTask(frame, camera, points, task.outputs)
        return _OpenedImage(task, image, sha256, time.perf_counter() - start_s)

    def _result(
        self, opened: _OpenedImage, done: ImageResult | Exception, share_s: float
    ) -> BatchResult:
        task, image, sha256, seconds = opened
        start_s = time.perf_counter() - seconds - share_s
        if isinstance(done, Exception):
            check_network(done, self.job.pipeline.session)
            return task.failed_result(done, self.key, start_s, sha256)
        provenance, anchors = done.depth.provenance, None
        if (fit := provenance.anchor_fit) and image.points is not None:
            residual_m = round(fit.residual_m, 6)
            model = None if provenance.model == self.key.model else provenance.model
            checksum = image.points.sha256()
            anchors = KnownDepthEntry(fit.given, fit.used, residual_m, checksum, fit.fit, model)
        try:
            files = tuple(output_entry(self.out, path) for path in task.outputs.values())
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            return task.failed_result(error, self.key, start_s, sha256)
        return task.result(
            self.key,
            start_s,
            sha256,
            outputs=files,
            warnings=done.warnings,
            camera=camera_text(done.depth),
            anchors=anchors,
        )

    def work_many(self, task: BatchTask, workers: int, progress: parallel.Progress) -> BatchResult:
        """Process one video, or one archive of images, with ``workers`` frames in parallel.

        ``progress`` is advanced for each frame. Raises as :meth:`work` does.
        """
        start_s, sha256 = time.perf_counter(), None
        try:
            with paths.local_copy(task.input.readable_path()) as source:
                sha256 = video_checksum(task, source, self.options)
                row = task.reusable_row(self.out, sha256, self.key)
                if row is not None:
                    return BatchResult(row, is_kept=True)
                task.check_outputs(overwrite=self.options.overwrite)
                if is_archive(task.input.name):
                    facts = self._write_archive(task, source, workers, progress)
                else:
                    facts = self._write_video(task, source, sha256, workers, progress)
                return task.result(self.key, start_s, sha256, **facts)
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            check_network(error, self.job.pipeline.session)
            return task.failed_result(error, self.key, start_s, sha256)

    def _write_archive(
        self, task: BatchTask, source: Path, workers: int, progress: parallel.Progress
    ) -> dict[str, Any]:
        """Write the outputs of an archive's images into one; returns fields of its row."""
        # Seldom needed.
        from depthcli.io.archives import archive_writer, members  # noqa: PLC0415
        from depthcli.io.bags import bag_members, bag_writer  # noqa: PLC0415

        options, (path,) = self.options, task.outputs.values()
        is_ros, writing = is_bag(task.input.name), options.writing
        if is_ros and (writing.is_normalized or writing.units_per_metre != MILLIMETRES):
            raise InputError("depth in a bag is in millimetres", "leave out {png_scale}")
        if is_ros:
            images, open_writer = bag_members(source, options.column, options.topic), bag_writer
        else:
            images, open_writer = members(source, options.column), archive_writer
        failed, warned, first, count = list[str](), dict[str, None](), None, 0
        stage = progress.begin(task.input.name, None, "images")

        def work(member: Member) -> tuple[Member, _Files | Exception]:
            try:
                return member, self._member_files(member, options.camera.of_image(task.intrinsics))
            except Exception as error:  # noqa: BLE001 - no image may stop the others
                check_network(error, self.job.pipeline.session)
                return member, error

        with (
            atomic.atomic_path(path) as temporary,
            open_writer(temporary, options.formats) as write,
            closing(parallel.ordered_map(work, images, workers=workers)) as done,
        ):
            for count, (member, image) in enumerate(done, start=1):  # noqa: B007 - the last one
                stage(1)
                if isinstance(image, Exception):
                    failed.append(about(member.name, failure_reason(image)))
                    write(member, {})
                    continue
                data, camera, warnings = image
                write(member, data)
                first = first or camera
                warned |= dict.fromkeys(warnings)
            if count == len(failed):
                raise InputError(failed[0] if failed else f"{source} holds no image")
        return {
            "outputs": (output_entry(self.out, path),),
            "error": f"{len(failed)} of {count} images failed, the first: {failed[0]}"
            if failed
            else None,
            "warnings": tuple(warned),
            "camera": first,
        }

    def _member_files(self, member: Member, camera: Intrinsics) -> _Files:
        if member.data is None:
            raise InputError("holds no image")
        options, has_focal = self.options, camera.has_focal
        if member.camera and not has_focal:  # options come before the bag
            camera = camera.of_image(member.camera)
        frame = options.read(Path(member.name), member.data)
        streams = {format_: BytesIO() for format_ in options.formats}
        points = options.points_of(member.origin, camera)
        done = self.job.run(ImageTask(frame, camera, points, streams))
        if member.origin and not done.depth.is_metric:
            raise InputError("depth in a bag is in metres", "choose a metric {model}")
        warnings = () if has_focal else camera.warnings
        files = {format_: stream.getvalue() for format_, stream in streams.items()}
        return files, camera_text(done.depth), (*warnings, *done.named_warnings(member.name))

    def _write_video(
        self, task: BatchTask, source: Path, sha256: str, workers: int, progress: parallel.Progress
    ) -> dict[str, Any]:
        """Write the outputs of a video; returns fields of its row."""
        # PyAV takes 60 ms to load, which a batch of images does not need.
        from depthcli.jobs.video.plan import VideoPlan, VideoRequest, VideoSettings  # noqa: PLC0415
        from depthcli.jobs.video.stages import write_video  # noqa: PLC0415

        options, out, name = self.options, self.out, task.input.name
        settings = VideoSettings(
            writing=options.writing,
            camera=options.camera.of_image(task.intrinsics),
            reading=options.reading,
            detail=options.detail,
            max_pixels=options.max_pixels,
        )
        overwrite = options.overwrite or task.is_listed
        plan = VideoPlan(
            name,
            source,
            (out / name).parent,
            {format_: path.name for format_, path in task.outputs.items()},
            VideoRequest(name, settings=settings, overwrite=overwrite),
            sha256=sha256,
        )
        done = write_video(plan, self.job.pipeline, workers, progress)
        files = _output_files(task.outputs, done.numbers)
        return {
            "outputs": tuple(output_entry(out, path) for path in files),
            "error": done.problem,
            "warnings": done.warnings,
            "camera": camera_text(done.depth),
        }


def _output_files(outputs: Mapping[VideoFormat, Path], numbers: Sequence[int]) -> Iterator[Path]:
    for format_, path in outputs.items():
        of_frames = (numbered_name(path.name, number) for number in numbers)
        yield from map(path.with_name, of_frames if format_ in SEQUENCES else [path.name])


def video_checksum(task: BatchTask, path: Path, options: BatchOptions) -> str:
    """SHA-256 of a video or an archive; InputError if it or the options cannot be used."""
    kind = "an archive" if is_archive(task.input.name) else "a video"
    if not set(task.outputs) - {VideoFormat.JSON}:
        raise InputError(f"{path} is {kind}, which no format holds", "add {format} png16")
    if options.anchors and not (is_bag(task.input.name) and options.topic):
        raise InputError(f"{path} is {kind}, to which anchors do not apply")
    with os_errors_as(InputError, f"{path} cannot be read"):
        paths.regular_size(path)  # no pipe, which may never end
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True, slots=True)
class WorkerSpec:
    """Plain values, which can be pickled, that a worker is built from."""

    model: SessionLoader  #: model, provider and threads
    model_sha256: str  #: checksum of the model's file, 64 hex digits; another one is refused
    options: BatchOptions  #: how each input is processed
    out: Path  #: the output folder

    def build(self, session: Session | None = None) -> Worker:
        """Build the worker in this process; ModelError if the model is another one here."""
        session = session or self.model.load()
        if session.model.sha256 != self.model_sha256:
            raise ModelError(
                f"{session.model.path} is not the model that this batch began with "
                f"(sha256 {self.model_sha256})",
                "copy that one here",
            )
        job = ImageJob(Pipeline(session, self.options.detail), self.options.writing)
        return Worker(self.options, self.out, self.key(session), job)

    def key(self, session: Session) -> CacheKey:
        """Fingerprint of the options, model and version that outputs are made with."""
        loaded, options = session.model, self.options
        checksum = validation.fingerprint(
            sorted(set(options.formats)),
            options.writing,
            options.camera,
            options.reading,
            options.detail,
            options.column,
            options.topic_facts(),
            session.identity(knows_depth=options.takes_known_depth),
        )
        return CacheKey(checksum, loaded.card.name, loaded.sha256, __version__)


Chunks = Iterable[Sequence[BatchTask]]
Record = Callable[[Sequence[BatchResult]], None]


class Engine(Protocol):
    """Workers on this machine, or on others."""

    def run(
        self, spec: WorkerSpec, chunks: Chunks, videos: Iterable[BatchTask], record: Record
    ) -> Generator[BatchResult, None, None]:
        """Process chunks of images, which a worker processes together, then videos.

        ``record`` is called with the results of a chunk in this process, from any thread, in any
        order, as soon as they are available; recorded results are safe. Yields the results; on this
        machine, in the order of the inputs. All running work is stopped when it is closed.
        """


_CHUNKS_AHEAD = 64  #: chunks per worker that may be done ahead of a slow one; they hold names only


@dataclass(frozen=True, slots=True)
class LocalEngine:
    """An :class:`Engine` of threads, which share the model of their process."""

    workers: int  #: chunks processed in parallel
    session: Session | None = None  #: the model, if it is loaded already
    progress: parallel.Progress = parallel.NO_PROGRESS  #: advanced for each frame of a video
    processes: int = 1  #: that images are divided among; 1 for this one alone

    def run(
        self, spec: WorkerSpec, chunks: Chunks, videos: Iterable[BatchTask], record: Record
    ) -> Generator[BatchResult, None, None]:
        """Process images, then videos one after another."""
        worker = spec.build(self.session)

        def work(chunk: Sequence[BatchTask]) -> list[BatchResult]:
            results = images.work(chunk)
            record(results)
            return results

        ahead = _CHUNKS_AHEAD * self.workers
        with (
            nullcontext(worker)
            if self.processes == 1
            else WorkerProcesses(spec, self.workers, self.processes, worker) as images,
            parallel.one_thread_each(self.workers),
            closing(parallel.ordered_map(work, chunks, workers=self.workers, ahead=ahead)) as done,
        ):
            for results in done:
                yield from results
        for task in videos:
            result = worker.work_many(task, self.workers, self.progress)
            record((result,))
            yield result


_THREADS = 4  #: of a process; more wait for each other
_LEAST_IMAGES = 200  #: below, starting processes takes longer than they save


def process_count(workers: int, images: Iterable[object]) -> int:
    """Number of processes for workers that process some images."""
    is_worth_it = len(list(islice(images, _LEAST_IMAGES))) == _LEAST_IMAGES
    return -(-workers // _THREADS) if is_worth_it else 1


class WorkerProcesses:
    """Processes that load a model each; used as a context, which ends them.

    Each answers a few connections, in a thread each: a ``ProcessPoolExecutor`` has one call at a
    time in a process, so that each thread would need a model of its own.
    """

    def __init__(self, spec: WorkerSpec, workers: int, count: int, here: Worker) -> None:
        """Start ``count`` processes with as many threads in all as there are workers.

        They stop when the session of the worker of this process is stopped.
        """
        context = multiprocessing.get_context("spawn")  # a fork would copy locks held by threads
        self._free: SimpleQueue[Connection] = SimpleQueue()
        self._processes = []
        for i in range(count):
            pipes = [context.Pipe() for _ in range(i, workers, count)]
            theirs = [end for _, end in pipes]
            process = context.Process(target=_serve, args=(spec, theirs), daemon=True)
            with parallel.without_interrupts():
                process.start()
            self._processes.append(process)
            for end in theirs:
                end.close()  # so that the other end tells when the process has ended
            for end, _ in pipes:
                self._free.put(end)
        here.job.pipeline.session.on_stop = self._stop

    def __enter__(self) -> Self:
        """The processes."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes, once no image is processed."""
        while not self._free.empty():
            self._free.get().close()
        for process in self._processes:
            process.join()

    def _stop(self) -> None:
        for process in self._processes:
            process.terminate()

    def work(self, chunk: Sequence[BatchTask]) -> list[BatchResult]:
        """Process some images, as :meth:`Worker.work` does, by a process that is free.

        EngineError if the process ends meanwhile.
        """
        end = self._free.get()
        try:
            end.send(chunk)
            answer: list[BatchResult] | Exception = end.recv()
        except (EOFError, OSError) as error:
            names = ", ".join(task.input.path for task in chunk)
            raise EngineError(
                f"a worker process was ended while it processed {names}",
                "if memory is short, use fewer {workers}; the same command resumes",
            ) from error
        finally:
            self._free.put(end)
        if isinstance(answer, Exception):
            raise answer
        return answer


def _serve(spec: WorkerSpec, ends: Sequence[Connection]) -> None:
    parallel.start_worker()
    loading = parallel.Background(spec.build)
    # Not the end of the process: Slurm and systemd signal the whole group.
    signal.signal(signal.SIGTERM, lambda *_: loading.result().job.pipeline.session.stop())
    threads = [Thread(target=_answer, args=(end, loading)) for end in ends]
    with parallel.one_thread_each(len(threads)):
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def _answer(end: Connection, loading: parallel.Background[Worker]) -> None:
    with end, suppress(EOFError, OSError):  # the other end is closed
        while True:
            chunk = end.recv()
            try:
                answer: object = loading.result().work(chunk)
            except Exception as error:  # noqa: BLE001 - raised again by WorkerProcesses.work
                answer = error
            end.send(answer)
