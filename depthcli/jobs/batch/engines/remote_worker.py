"""A worker on another machine, and the calls that are sent to it."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from depthcli._version import __version__
from depthcli.core.progress import NO_PROGRESS
from depthcli.errors import EngineError
from depthcli.io.images.native_log import silent_opencv
from depthcli.io.storage.remote import RemotePath
from depthcli.jobs.batch.videos import VideoTask, VideoWorker

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from depthcli.io.manifest.row import Origin
    from depthcli.jobs.batch.pictures import PictureTask, PictureWorker
    from depthcli.jobs.batch.task import Result, Task
    from depthcli.jobs.batch.worker_spec import WorkerSpec


@dataclass(frozen=True, slots=True)
class Call:
    """One request to a worker: chunks of pictures, or a video."""

    chunks: tuple[Sequence[PictureTask], ...] = ()
    video: VideoTask | None = None
    lost_workers: int = 0  #: workers that died with it

    def split(self) -> Iterator[Call]:
        """One call for each input, after its worker was lost."""
        if self.video is not None:
            yield Call(video=self.video, lost_workers=self.lost_workers + 1)
        for chunk in self.chunks:
            for task in chunk:
                yield Call(chunks=((task,),), lost_workers=self.lost_workers + 1)

    @property
    def task(self) -> Task[Any]:
        """The first input."""
        return self.video or self.chunks[0][0]


class RemoteWorker:
    """A worker process on a cluster."""

    def __init__(self, spec: WorkerSpec, folder: str, cpus: float) -> None:
        """Store the arguments; nothing is loaded yet, so that errors come with the first call."""
        self._spec, self._folder, self._cpus = spec, folder, max(1, int(cpus))
        self._worker: PictureWorker | None = None

    def start(self, version: str) -> Origin:
        """Load the model.

        Raises:
            EngineError: this machine has another version, or no access to the output folder.
            ModelError: the model cannot be loaded here, or is another one.
        """
        here = socket.gethostname()
        if version != __version__:
            raise EngineError(f"{here} has depthcli {__version__}; install {version} there")
        if Path(self._folder).is_dir():
            os.chdir(self._folder)  # so that relative paths mean the same as for the driver
        out = self._spec.out
        if not isinstance(out, RemotePath) and not out.is_dir():
            raise EngineError(
                f"{here} cannot see {out}; put inputs and --out where all machines can"
            )
        cv2.setNumThreads(self._cpus)
        self._worker = self._spec.build()
        return self._worker.origin

    def work(self, call: Call) -> list[Result]:
        """Process the inputs of a call.

        Raises:
            ModelError: the network fails on any picture.
        """
        if self._worker is None:
            raise TypeError(self._worker)
        with silent_opencv():
            if call.video is not None:
                return [VideoWorker(self._worker, self._cpus, NO_PROGRESS).work(call.video)]
            return [result for chunk in call.chunks for result in self._worker.work(chunk)]
