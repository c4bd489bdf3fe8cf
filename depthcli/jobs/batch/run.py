"""What ``depthcli batch`` does: all inputs by an engine, and an account of them."""

import dataclasses
import os
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from itertools import islice

from depthcli.core.choices import GPU_BATCH
from depthcli.core.parallel.cores import share_cores
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.inference.providers import CPU
from depthcli.inference.session import Session
from depthcli.io.manifest.journal import Journal
from depthcli.io.manifest.rows_folder import rows_folder
from depthcli.io.opencv_log import silent_opencv
from depthcli.io.storage.remote import RemotePath
from depthcli.io.storage.temporaries import remove_stale
from depthcli.jobs.batch.engines.engine import Engine
from depthcli.jobs.batch.engines.threads import ThreadEngine
from depthcli.jobs.batch.options import BatchRequest
from depthcli.jobs.batch.output_map import OutputMap
from depthcli.jobs.batch.suspects import suspected
from depthcli.jobs.batch.tally import Tally
from depthcli.jobs.batch.task import Result
from depthcli.jobs.batch.worker_spec import WorkerSpec


class Batch(Iterator[Result]):
    """A batch at work: what became of each input; by threads pictures first, in the plan's order.

    A bad input never stops the others. The manifest is written when the last result was given, or
    when the batch is closed; the same request goes on where an earlier one was stopped.

    Attributes:
        warnings: what is to be known of the whole batch, one line each.
        tally: what became of the inputs so far.
        late: results that were there when the batch was closed and that nobody had asked for.
        manifest: the file that tells of each input in the end.
        stopped: why the batch was given up before its last input; None if it was not.
    """

    def __init__(
        self,
        request: BatchRequest,
        session: Session | None = None,
        engine: Engine | None = None,
        progress: Progress = NO_PROGRESS,
    ) -> None:
        """Load the model and take the output folder.

        Args:
            request: what to do.
            session: the request's model, where that is loaded already.
            engine: what processes the inputs; None for threads of this process.
            progress: told of each frame of a video that a thread does.

        Raises:
            ModelError: the model cannot be used.
            OutputError: the output folder cannot be written.
            UsageError: the options do not fit the model or the inputs, or another batch writes
                there.
        """
        plan, options = request.plan, request.options
        workers, threads = share_cores(request.workers, request.model.threads)
        model = dataclasses.replace(request.model, threads=threads)
        session = session or model.load()
        self._engine = engine or ThreadEngine(workers, session, progress)
        self._spec = WorkerSpec(model, session.model.sha256, options, plan.out)
        self._spec.build(session).pipeline.check_focal(
            options.camera.focal_px, options.camera.hfov_deg
        )
        self._chunk = request.batch_size or (1 if session.provider == CPU else GPU_BATCH)
        self._plan, self._outputs = plan, OutputMap(plan, options.formats)
        self._outputs.check_apart()
        self._rows = rows_folder(plan.out)
        self._journal: Journal | None = Journal(self._rows.path, plan.shard, request.manifest)
        self.manifest = plan.out / self._journal.manifest.name
        at_once = max(workers, os.cpu_count() or 1) * self._chunk
        self._begun = at_once if self._journal.was_cut_short else 0
        if self._journal.was_cut_short and not isinstance(plan.out, RemotePath):
            for folder in plan.folders():
                remove_stale(folder)
        self.warnings = (*plan.warnings, *session.warnings)
        self.tally = Tally(len(plan.inputs))
        self._budget = request.budget
        self.stopped: str | None = None
        self.late: tuple[Result, ...] = ()
        self._recorded: dict[str, Result] = {}
        self._passed: dict[str, bool] = {}  # name -> whether its outputs were kept
        self._results = self._run(self._journal)

    def __next__(self) -> Result:
        """What became of the next input.

        Raises:
            ModelError: the network fails on any picture.
            OutputError: the journal or the manifest cannot be written.
        """
        return next(self._results)

    def close(self) -> None:
        """Stop, and write the manifest of what is done."""
        self._results.close()
        self._finish()  # a generator that never began has no end of its own

    def _run(self, journal: Journal) -> Generator[Result, None, None]:
        pictures = (self._outputs.picture(file, journal) for file in self._plan.pictures)
        films = (self._outputs.video(file, journal) for file in self._plan.videos)
        tasks = suspected(pictures, journal, self._begun)
        chunks = iter(lambda: tuple(islice(tasks, self._chunk)), ())
        videos = suspected(films, journal, min(1, self._begun))
        try:
            with (
                silent_opencv(),
                closing(self._engine.run(self._spec, chunks, videos, self._record)) as results,
            ):  # no worker outlives the journal
                for result in results:
                    yield self._taken(result)
                    if self._is_spent():
                        return
        finally:
            self._finish()

    def _record(self, results: Sequence[Result]) -> None:
        for result in results:
            if not result.is_kept and self._journal is not None:
                self._journal.add(result.row)
            self._recorded[result.row.input] = result
        self._rows.keep()

    def _taken(self, result: Result) -> Result:
        del self._recorded[result.row.input]
        self._passed[result.row.input] = result.is_kept
        self.tally.add(result)
        return result

    def _is_spent(self) -> bool:
        """Whether so much failed that the batch is to stop."""
        if self._budget is not None and self.tally.passed < self.tally.total:
            self.stopped = self._budget.reason(self.tally)
        return self.stopped is not None

    def _finish(self) -> None:
        """Write the manifest, once."""
        journal, self._journal = self._journal, None
        if journal is None:
            return
        names = [file.name for file in self._plan.inputs]
        if not isinstance(self._plan.out, RemotePath):  # each output costs a request there
            for name in names:
                self._check(journal, name)
        self.late = tuple(self._recorded[name] for name in names if name in self._recorded)
        for result in self.late:
            self.tally.add(result)
        journal.finish(names)
        self._rows.finish()

    def _check(self, journal: Journal, name: str) -> None:
        """An input is not done where somebody has removed its outputs again meanwhile."""
        row = journal.row(name) if name in self._passed or name in self._recorded else None
        lost = row.lost(self._plan.out) if row else None
        if lost is None:
            return
        journal.add(lost)
        if name in self._passed:
            self.tally.lose(lost, was_kept=self._passed[name])
        else:
            self._recorded[name] = Result(lost)
