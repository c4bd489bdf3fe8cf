"""Where a batch runs: in the threads of this process, or on a cluster."""

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from enum import StrEnum
from typing import Any

from depthcli.core.progress import Progress
from depthcli.errors import UsageError
from depthcli.jobs.batch.engines.engine import Engine

_OF_RAY = {
    "ray_address": "--ray-address",
    "cpus_per_worker": "--cpus-per-worker",
    "gpus_per_worker": "--gpus-per-worker",
}


class EngineName(StrEnum):
    """What processes the inputs of a batch."""

    THREADS = "threads"
    RAY = "ray"


@contextmanager
def chosen_engine(given: Mapping[str, Any], progress: Progress) -> Iterator[Engine | None]:
    """The engine that options ask for, as long as it is needed; None for threads.

    Args:
        given: values of the options by the names of their parameters.
        progress: asked now and then whether to go on, while a cluster works.

    Raises:
        UsageError: an option is for another engine, or Ray is not installed.
        EngineError: there is no cluster, or it cannot be used.
    """
    if given["engine"] != EngineName.RAY:
        for name, word in _OF_RAY.items():
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
