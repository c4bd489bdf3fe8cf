"""Running a batch in threads of this process, which share one model."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from depthcli.core.parallel import one_thread_each, ordered_map
from depthcli.core.progress import NO_PROGRESS, Progress

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Sequence

    from depthcli.inference.session import Session
    from depthcli.jobs.batch.tasks import BatchResult
    from depthcli.jobs.batch.workers import ImageTask, VideoTask, WorkerSpec


_CHUNKS_AHEAD = 64
"""Chunks per worker that may be done ahead of a slow one; they hold names only."""


@dataclass(frozen=True, slots=True)
class ThreadEngine:
    """An :class:`depthcli.jobs.batch.threads.Engine`."""

    workers: int  #: chunks processed in parallel
    session: Session | None = None  #: the model, if it is loaded already
    progress: Progress = NO_PROGRESS  #: advanced for each frame of a video

    def run(
        self,
        spec: WorkerSpec,
        chunks: Iterable[Sequence[ImageTask]],
        videos: Iterable[VideoTask],
        record: Callable[[Sequence[BatchResult]], None],
    ) -> Generator[BatchResult, None, None]:
        """Process pictures, then videos one after another, as every engine does."""
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
            from depthcli.jobs.batch.workers import VideoWorker  # noqa: PLC0415 - it loads PyAV

            result = VideoWorker(worker, self.workers, self.progress).work(task)
            record((result,))
            yield result


class Engine(Protocol):
    """Workers in threads, in processes or on other machines."""

    def run(
        self,
        spec: WorkerSpec,
        chunks: Iterable[Sequence[ImageTask]],
        videos: Iterable[VideoTask],
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
