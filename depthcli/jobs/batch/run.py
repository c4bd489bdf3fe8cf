"""Running a batch: processes all inputs with an engine, and writes the manifest and tables.

The tables are for programs that reconstruct a scene. 3D Gaussian splatting reads
``sparse/0/depth_params.json`` and ``a.png`` for ``a.jpg`` (github.com/graphdeco-inria/
gaussian-splatting), nerfstudio reads ``transforms.json`` (docs.nerf.studio), and COLMAP
``stereo/depth_maps/a.jpg.geometric.bin``.
"""

import hashlib
import json
import os
import time
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

from depthcli.core import parallel, validation
from depthcli.core.options import GPU_BATCH, SceneLayout
from depthcli.errors import InputError, OutputError, UsageError, os_errors_as
from depthcli.inference.loading import SessionLoader
from depthcli.inference.session import CPU, Session
from depthcli.inference.transforms import focal_warnings
from depthcli.io.formats.raster import read_metadata
from depthcli.io.guard import Guard
from depthcli.io.images.read import check
from depthcli.io.manifest import WHOLE, Journal, ManifestRow, known_rows
from depthcli.io.storage.atomic import remove_stale, write_text
from depthcli.io.storage.paths import local_copy, read_bytes, safe_name
from depthcli.io.stored.metadata import SOFTWARE, UINT16_MAX
from depthcli.jobs.batch.plan import BatchPlan, holds_many
from depthcli.jobs.batch.tasks import BatchOptions, BatchResult, TaskBuilder
from depthcli.jobs.batch.workers import (
    Engine,
    LocalEngine,
    WorkerSpec,
    process_count,
    video_checksum,
)


@dataclass(slots=True)
class Tally:
    """Counts of results."""

    total: int  #: number of inputs
    done: int = 0  #: inputs that were processed, including the failed ones
    kept: int = 0  #: inputs whose outputs of an earlier run are still valid
    failures: list[tuple[str, str]] = field(default_factory=list)  #: name and reason
    start_s: float = field(default_factory=time.monotonic)

    def add(self, result: BatchResult) -> None:
        """Count a result."""
        error = result.row.error
        self.kept += result.is_kept
        self.done += not result.is_kept
        if error is not None:
            self.failures.append((result.row.input, error))

    @property
    def completed(self) -> int:
        """Inputs that are done or kept."""
        return self.done + self.kept


@dataclass(frozen=True, slots=True)
class BatchRequest:
    """A batch."""

    plan: BatchPlan  #: inputs, and the names of their outputs
    #: how each input is processed
    options: BatchOptions = field(default_factory=BatchOptions)
    #: model, provider and threads; by default, threads per worker are cores / workers
    model: SessionLoader = field(default_factory=SessionLoader)
    workers: int | None = None  #: images, or chunks of them, in parallel; None for one per core
    batch_size: int | None = None  #: images per inference; None for the provider's default
    max_failures: int | None = None  #: it stops after more; None for no limit
    #: whether more than four workers may be spread over processes, which import the main module;
    #: they are for 200 images or more on the CPU
    may_spawn: bool = False


class Batch(Iterator[BatchResult]):
    """An iterator of the results of a batch; with threads, images first, in the plan's order.

    A bad input never stops the others. The manifest is written after the last result, or when the
    batch is closed; the same request resumes a batch that was stopped.

    Attributes:
        warnings: about the whole batch, one line each.
        tally: counts of the results so far.
        late: results that were available when the batch was closed, and not yet iterated over.
        manifest: path of the manifest.
        stopped: why the batch was stopped before its last input; None if it was not.
    """

    def __init__(
        self,
        request: BatchRequest,
        session: Session | None = None,
        engine: Engine | None = None,
        progress: parallel.Progress = parallel.NO_PROGRESS,
    ) -> None:
        """Load the model, unless there is a session of it, and lock the output folder.

        ``engine`` runs the workers; None for threads of this process, with which ``progress`` is
        advanced for each frame of a video. UsageError if the options do not fit the inputs, or
        another batch writes there.
        """
        plan, options = request.plan, request.options
        workers, threads = parallel.share_cores(request.workers, request.model.threads)
        model = replace(request.model, threads=threads)
        session = session or model.load()
        images = plan.images if request.may_spawn and session.provider == CPU else ()
        processes = process_count(workers, images)
        self._engine = engine or LocalEngine(workers, session, progress, processes)
        self._spec = WorkerSpec(model, session.model.sha256, options, plan.out)
        camera = next(iter(plan.intrinsics.values()), options.camera)
        focal = () if options.anchors else focal_warnings(session.model.card, camera)
        self._chunk = request.batch_size or (1 if session.provider == CPU else GPU_BATCH)
        self._plan = plan
        TaskBuilder(plan, options).check_conflicts()
        self._tables = options.layout, options.transforms, plan.out
        check_tables(*self._tables, overwrite=options.overwrite)
        self._journal: Journal | None = Journal(plan.out, plan.shard, plan.names.names)
        self._tasks = TaskBuilder(plan, options, self._journal)
        self.manifest = self._journal.manifest
        self._remove_stale()  # of killed runs, which may fill the disk
        self.warnings = (*plan.warnings, *options.camera.warnings, *session.warnings, *focal)
        self.tally = Tally(len(plan.inputs))
        self._max_failures = request.max_failures
        self.stopped: str | None = None
        self.late: tuple[BatchResult, ...] = ()
        self._recorded: dict[str, BatchResult] = {}
        self._results = self._run()

    def __next__(self) -> BatchResult:
        """The result of the next input; ModelError if the network fails on any image."""
        return next(self._results)

    def close(self) -> None:
        """Stop, and write the manifest of the inputs that are done."""
        self._results.close()
        self._finish()  # closing a generator that was never started runs no finally

    def _run(self) -> Generator[BatchResult, None, None]:
        images = map(self._tasks.task, self._plan.images)
        chunks = iter(lambda: tuple(islice(images, self._chunk)), ())
        videos = map(self._tasks.task, self._plan.videos)
        try:
            # No worker outlives the journal.
            with closing(self._engine.run(self._spec, chunks, videos, self._record)) as results:
                for result in results:
                    del self._recorded[result.row.input]
                    self.tally.add(result)
                    yield result
                    most = self._max_failures
                    is_over = most is not None and len(self.tally.failures) > most
                    if is_over and self.tally.completed < self.tally.total:
                        self.stopped = f"more than {most} of the inputs failed"
                        return
        finally:
            self._finish()

    def _record(self, results: Sequence[BatchResult]) -> None:
        for result in results:
            if not result.is_kept and self._journal is not None:
                self._journal.add(result.row)
            self._recorded[result.row.input] = result

    def _finish(self) -> None:
        journal, self._journal = self._journal, None
        if journal is None:
            return
        names = [file.name for file in self._plan.inputs]
        self.late = tuple(self._recorded[name] for name in names if name in self._recorded)
        for result in self.late:
            self.tally.add(result)
        journal.finish(names, keep_failed=self._plan.is_part)
        write_tables(*self._tables, known_rows(self._plan.out))
        self._remove_stale()  # of this run: workers of a cluster can be killed

    def _remove_stale(self) -> None:
        out, inputs = self._plan.out, self._plan.inputs
        folders = {out, *((out / file.name).parent for file in inputs)}
        for folder in folders if self._plan.shard == WHOLE else ():
            remove_stale(folder)


DryRun: TypeAlias = tuple[str, str, tuple[Path, ...], str | None]
"""What a batch would do with an input (do, keep or fail), its name, its outputs, and why."""


def dry_run(request: BatchRequest, session: Session) -> Iterator[DryRun]:
    """Yield the plan for each input, in order; UsageError if an output would replace an input."""
    plan, options, out = request.plan, request.options, request.plan.out
    tasks = TaskBuilder(plan, options, known_rows(out, plan.shard, plan.names.names))
    tasks.check_conflicts()
    key = WorkerSpec(request.model, session.model.sha256, options, out).key(session)
    for task in map(tasks.task, plan.inputs):
        file, row, problem = task.input, None, None
        try:
            if holds_many(file.name):
                with local_copy(file.readable_path()) as source:
                    row = task.reusable_row(out, video_checksum(task, source, options), key)
            else:
                data = read_bytes(file.readable_path())
                check(data, safe_name(file.path), options.max_pixels)
                points = options.points_for(task)
                row = task.reusable_row(out, hashlib.sha256(data).hexdigest(), key, points)
            if row is None:
                task.check_outputs(overwrite=options.overwrite)
        except (InputError, OutputError) as error:
            problem = error.message
        would = "fail" if problem else "keep" if row else "do"
        yield would, file.name, tuple(task.outputs.values()), problem


DEPTH_PARAMS, TRANSFORMS = "depth_params.json", "transforms.json"
_READER_STEPS = 2**16  # 3D Gaussian splatting divides by it
_PATHS = ("ply_file_path", "file_path", "mask_path")  # of transforms.json, relative to its folder


def check_tables(
    layout: SceneLayout | None, transforms: Path | None, out: Path, *, overwrite: bool
) -> None:
    """Check, before a batch, that its tables may be written.

    OutputError if not, or UsageError if ``transforms`` is not nerfstudio's.
    """
    guard = Guard.of([transforms] if transforms else [], overwrite=overwrite)
    if layout is SceneLayout.GSPLAT:
        guard.check(out / DEPTH_PARAMS)
    if transforms is not None:
        read_transforms(transforms)
        guard.check(out / TRANSFORMS)


def write_tables(
    layout: SceneLayout | None, transforms: Path | None, out: Path, rows: Iterable[ManifestRow]
) -> None:
    """Write the tables of the images that have depth in an output folder."""
    done = [row for row in rows if row.outputs]
    if layout is SceneLayout.GSPLAT:
        _write(out / DEPTH_PARAMS, dict(_depth_params(out, done)))
    if transforms is not None:
        _write(out / TRANSFORMS, _with_depth(transforms, out, done))


def _depth_params(out: Path, rows: Collection[ManifestRow]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Scale and offset of each PNG, by its name without suffix.

    Inverse depth is ``steps / 65536 * scale + offset``, where the PNG has 1 for the lower end of
    its range and 65535 for the higher.
    """
    paths = (file.path for row in rows for file in row.outputs if file.path.endswith(".png"))
    for path in (path for path in paths if (out / path).is_file()):
        texts = read_metadata(out / path)
        if texts.get("scale") == "inverse":
            low, high = map(float, texts["range"].split())
            step = (high - low) / (UINT16_MAX - 1)
            numbers = {"scale": step * _READER_STEPS, "offset": low - step}
            yield path.removesuffix(".png"), {**numbers, "software": SOFTWARE}


def read_transforms(path: Path) -> dict[str, Any]:
    """The description of a scene for nerfstudio; UsageError if it cannot be read."""
    with os_errors_as(UsageError, f"cannot read {path}"):
        data = path.read_bytes()
    try:
        scene: Any = validation.parsed_json(data)
        if all(isinstance(frame["file_path"], str) for frame in scene["frames"]):
            return dict(scene)
    except (validation.FieldError, KeyError, TypeError):
        pass
    raise UsageError(f"{path} has no frames with a file_path", option="transforms")


def _with_depth(path: Path, out: Path, rows: Iterable[ManifestRow]) -> dict[str, Any]:
    """A scene with the depth of each frame; frames without are left out, as nerfstudio needs it."""
    scene, folder = read_transforms(path), path.parent
    depths = {
        os.path.realpath(str(row.input_path)): file.path
        for row in rows
        for file in row.outputs
        if file.path.endswith(".png")
    }
    frames = []
    for frame in scene["frames"]:
        depth = depths.get(os.path.realpath(folder / frame["file_path"]))
        if depth is not None:
            frames.append({**_moved(frame, folder, out), "depth_file_path": depth})
    return {"software": SOFTWARE, **_moved(scene, folder, out), "frames": frames}


def _moved(fields: Mapping[str, Any], folder: Path, out: Path) -> dict[str, Any]:
    """Fields whose paths start from another folder."""
    paths = {name: fields[name] for name in _PATHS if name in fields}
    return {**fields, **{n: os.path.relpath(folder / path, out) for n, path in paths.items()}}


def _write(path: Path, table: Mapping[str, Any]) -> None:
    write_text(json.dumps(table, indent=2) + "\n", path)
