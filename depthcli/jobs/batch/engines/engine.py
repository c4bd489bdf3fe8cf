"""The interface of an engine, which runs the workers of a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Sequence

    from depthcli.jobs.batch.pictures import PictureTask
    from depthcli.jobs.batch.task import Result
    from depthcli.jobs.batch.videos import VideoTask
    from depthcli.jobs.batch.worker_spec import WorkerSpec


class Engine(Protocol):
    """Workers in threads, in processes or on other machines."""

    def run(
        self,
        spec: WorkerSpec,
        chunks: Iterable[Sequence[PictureTask]],
        videos: Iterable[VideoTask],
        record: Callable[[Sequence[Result]], None],
    ) -> Generator[Result, None, None]:
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
