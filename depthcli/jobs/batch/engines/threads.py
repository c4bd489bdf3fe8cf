"""Running a batch in threads of this process, which share one model."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

from depthcli.core.parallel.opencv_threads import one_thread_each
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.core.progress import NO_PROGRESS, Progress

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Sequence

    from depthcli.inference.session import Session
    from depthcli.jobs.batch.pictures import PictureTask
    from depthcli.jobs.batch.task import Result
    from depthcli.jobs.batch.videos import VideoTask
    from depthcli.jobs.batch.worker_spec import WorkerSpec

_CHUNKS_AHEAD = 64
"""Chunks per worker that may be done ahead of a slow one; they hold names only."""


@dataclass(frozen=True, slots=True)
class ThreadEngine:
    """An :class:`depthcli.jobs.batch.engines.engine.Engine`."""

    workers: int  #: chunks processed in parallel
    session: Session | None = None  #: the model, if it is loaded already
    progress: Progress = NO_PROGRESS  #: advanced for each frame of a video

    def run(
        self,
        spec: WorkerSpec,
        chunks: Iterable[Sequence[PictureTask]],
        videos: Iterable[VideoTask],
        record: Callable[[Sequence[Result]], None],
    ) -> Generator[Result, None, None]:
        """Process pictures, then videos one after another, as every engine does."""
        worker = spec.build(self.session)

        def work(chunk: Sequence[PictureTask]) -> list[Result]:
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
            from depthcli.jobs.batch.videos import VideoWorker  # noqa: PLC0415 - it loads PyAV

            result = VideoWorker(worker, self.workers, self.progress).work(task)
            record((result,))
            yield result
