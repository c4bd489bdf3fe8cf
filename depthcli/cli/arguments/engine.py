"""The engine of a batch: threads of this process, or a Ray cluster."""

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from enum import StrEnum
from typing import Any

from depthcli.core.progress import Progress
from depthcli.errors import UsageError
from depthcli.jobs.batch.engines.engine import Engine

_RAY_OPTIONS = {
    "ray_address": "--ray-address",
    "cpus_per_worker": "--cpus-per-worker",
    "gpus_per_worker": "--gpus-per-worker",
}


class EngineName(StrEnum):
    """Names of the engines."""

    THREADS = "threads"
    RAY = "ray"


@contextmanager
def open_engine(given: Mapping[str, Any], progress: Progress) -> Iterator[Engine | None]:
    """The engine of the options, closed after the block; None for threads.

    Args:
        given: values of the options by parameter name.
        progress: called with 0 while a cluster works, so that it can stop the work by raising.

    Raises:
        UsageError: an option is for another engine, or Ray is not installed.
        EngineError: there is no cluster, or it cannot be used.
    """
    if given["engine"] != EngineName.RAY:
        for name, word in _RAY_OPTIONS.items():
            if given[name] is not None:
                raise UsageError(f"{word} is for --engine ray; add that, or leave it out")
        yield None
        return
    from depthcli.jobs.batch.engines.ray import RayEngine

    engine = RayEngine(
        given["ray_address"],
        workers=given["workers"],
        cpus=given["cpus_per_worker"] or 1,
        gpus=given["gpus_per_worker"] or 0,
        progress=progress,
    )
    with closing(engine):
        yield engine
