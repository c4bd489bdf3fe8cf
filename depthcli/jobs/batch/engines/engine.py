"""What processes the pictures of a batch."""

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
            spec: what each worker is built from, wherever it is.
            chunks: pictures that a worker does together; pulled by the thread that iterates.
            videos: pulled after the pictures.
            record: to be told of the results of a chunk in this process, from any thread, in any
                order, as soon as they are there: what is recorded is safe.

        Yields:
            The results, of threads in the order of the inputs. When the iterator is closed,
            nothing that was begun goes on.

        Raises:
            ModelError: the network fails on any picture.
            UsageError: the options do not fit the model.
        """
