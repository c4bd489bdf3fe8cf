"""What a batch would do, without a trace."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from depthcli.errors import InputError
from depthcli.inference.session import Session
from depthcli.io.listing.folder import InputFile, is_video
from depthcli.io.manifest.journal import Rows, known_rows
from depthcli.io.manifest.row import Origin
from depthcli.io.pictures.decode import check
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.io.storage.transfer import local_copy
from depthcli.jobs.batch.options import BatchRequest
from depthcli.jobs.batch.output_map import OutputMap
from depthcli.jobs.batch.pictures import read_input
from depthcli.jobs.batch.videos import checked_video
from depthcli.jobs.batch.worker_spec import WorkerSpec


@dataclass(frozen=True, slots=True)
class Forecast:
    """What would become of an input."""

    input: str  #: its name
    would: Literal["do", "keep", "fail"]  #: do it, keep what an earlier batch wrote, or fail
    outputs: tuple[Path, ...]  #: the files of its outputs
    error: str | None = None  #: why it would fail; None if it would not


def forecast(request: BatchRequest, session: Session) -> Iterator[Forecast]:
    """What would become of each input, in their order; inputs are read for it.

    Args:
        request: the batch.
        session: its model.

    Raises:
        UsageError: an output would replace an input.
    """
    plan, options = request.plan, request.options
    outputs = OutputMap(plan, options.formats)
    outputs.check_apart()
    spec = WorkerSpec(request.model, session.model.sha256, options, plan.out)
    origin, rows = spec.origin(session), known_rows(plan.out, plan.shard)
    return (_forecast(file, request, outputs, rows, origin) for file in plan.inputs)


def _forecast(
    file: InputFile, request: BatchRequest, outputs: OutputMap, rows: Rows, origin: Origin
) -> Forecast:
    paths = tuple(outputs.of(file).values())
    try:
        if is_video(file.name):
            video = outputs.video(file, rows)
            with local_copy(path_of(file.path)) as source:
                sha256 = checked_video(video, source, request.options.camera)
            kept = video.kept(request.plan.out, sha256, origin)
        else:
            data = read_input(file)
            check(data, safe_name(file.path), request.options.limit)
            sha256 = hashlib.sha256(data).hexdigest()
            kept = outputs.picture(file, rows).kept(request.plan.out, sha256, origin)
    except InputError as error:
        return Forecast(file.name, "fail", paths, str(error))
    return Forecast(file.name, "keep" if kept else "do", paths)
