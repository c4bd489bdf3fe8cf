"""What ``depthcli batch`` does: all inputs by several workers, and an account of them."""

from __future__ import annotations

from contextlib import closing
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

from depthcli.cli.screen.progress import drawn
from depthcli.core.parallel.opencv_threads import one_thread_each
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.errors import ExitCode
from depthcli.io.opencv_log import silent_opencv
from depthcli.jobs.batch.journal import Journal, known_rows, remove_leftovers
from depthcli.jobs.batch.pictures import Worker
from depthcli.jobs.batch.recipe import Targets
from depthcli.jobs.batch.tally import Tally

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator

    from depthcli.cli.screen.batch import Voice
    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.listing.folder import Found
    from depthcli.jobs.batch.manifest import Origin
    from depthcli.jobs.batch.pictures import Result
    from depthcli.jobs.batch.plan import Plan
    from depthcli.jobs.batch.recipe import Recipe

_AHEAD = 64
"""Chunks a worker may be ahead of one that takes long; they hold names only."""


class Batch(NamedTuple):
    """One run of the command.

    Attributes:
        plan: inputs and names.
        recipe: options of the outputs.
        pipeline: the model.
        workers: pictures, or chunks of them, at the same time.
        batch_size: pictures in one run of the network.
        voice: what is said.
    """

    plan: Plan
    recipe: Recipe
    pipeline: Pipeline
    workers: int
    batch_size: int
    voice: Voice

    def run(self) -> int:
        """Work off all inputs; a bad one never stops the others.

        Returns:
            The exit code.

        Raises:
            ModelError: the network fails on any picture.
            OutputError: the output folder cannot be written.
            UsageError: another batch writes there.
        """
        camera = self.recipe.camera
        self.pipeline.check_focal(camera.focal_px, camera.hfov_deg)
        origin = self.recipe.origin(self.pipeline)
        Targets(self.plan, self.recipe, origin, known_rows(self.plan.out)).check_apart()
        journal = Journal(self.plan.out)
        if journal.was_cut_short:
            remove_leftovers(self.plan.folders())
        tally = Tally(len(self.plan.inputs))
        late: list[Result] = []
        self.voice.warn((*self.plan.warnings, *self.pipeline.session.warnings))
        try:
            silent = self.voice.quiet or self.voice.as_json
            with (
                silent_opencv(),
                one_thread_each(self.workers),
                drawn(silent=silent) as progress,
                closing(
                    self._results(origin, journal, late)
                ) as results,  # no worker outlives the journal
            ):
                stage = progress.begin("", tally.total, "inputs")
                for result in results:
                    self._account(result, tally)
                    stage.note = f"{len(tally.failures)} failed" if tally.failures else ""
                    (stage.skip if result.is_kept else stage)(1)
        finally:
            # First, because nobody may be left to be told.
            journal.finish(found.name for found in self.plan.inputs)
            for result in late:
                self._account(result, tally)
            self.voice.sum_up(self.plan, tally)
        return ExitCode.SOME_FAILED if tally.failures else ExitCode.OK

    def _account(self, result: Result, tally: Tally) -> None:
        tally.add(result)
        self.voice.tell(result)

    def _results(
        self, origin: Origin, journal: Journal, late: list[Result]
    ) -> Generator[Result, None, None]:
        """Results in order; those that come after an interruption are put into ``late``."""
        targets = Targets(self.plan, self.recipe, origin, journal)
        worker = Worker(targets, self.pipeline, journal)
        chunks = _chunks(self.plan.pictures, self.batch_size)
        ahead = _AHEAD * self.workers
        with closing(
            ordered_map(worker.work, chunks, workers=self.workers, ahead=ahead, late=late.extend)
        ) as results:
            for chunk in results:
                yield from chunk
        if any(True for _ in self.plan.videos):
            from depthcli.jobs.batch.videos import VideoWorker

            videos = VideoWorker(targets, self.pipeline, journal, self.workers)
            yield from map(videos.work, self.plan.videos)


def _chunks(inputs: Iterable[Found], size: int) -> Iterator[tuple[Found, ...]]:
    remaining = iter(inputs)
    while chunk := tuple(islice(remaining, size)):
        yield chunk
