"""The dry run of a batch: what it would do, without writing anything."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from depthcli.errors import InputError, OutputError
from depthcli.inference.session import Session
from depthcli.io.images.decode import check
from depthcli.io.listing.folder import InputFile, is_video
from depthcli.io.manifest.journal import Rows, known_rows
from depthcli.io.manifest.row import Origin
from depthcli.io.storage.remote import safe_name
from depthcli.io.storage.transfer import local_copy
from depthcli.jobs.batch.options import BatchRequest
from depthcli.jobs.batch.output_map import OutputMap
from depthcli.jobs.batch.pictures import read_input
from depthcli.jobs.batch.videos import video_checksum
from depthcli.jobs.batch.worker_spec import WorkerSpec


@dataclass(frozen=True, slots=True)
class DryRunResult:
    """What would be done for an input."""

    input: str  #: its name
    would: Literal["do", "keep", "fail"]  #: process it, keep its valid outputs, or fail
    outputs: tuple[Path, ...]  #: paths of its outputs
    error: str | None = None  #: why it would fail; None if it would not


def dry_run(request: BatchRequest, session: Session) -> Iterator[DryRunResult]:
    """What would be done for each input, in order; inputs are read and checked.

    Args:
        request: the batch.
        session: its model.

    Raises:
        UsageError: an output would replace an input, or the output for another input.
    """
    plan, options = request.plan, request.options
    outputs = OutputMap(plan, options.formats)
    outputs.check_conflicts()
    spec = WorkerSpec(request.model, session.model.sha256, options, plan.out)
    origin, rows = spec.origin(session), known_rows(plan.out, plan.shard)
    outputs.check_earlier(rows)
    return (_dry_run_of(file, request, outputs, rows, origin) for file in plan.inputs)


def _dry_run_of(
    file: InputFile, request: BatchRequest, outputs: OutputMap, rows: Rows, origin: Origin
) -> DryRunResult:
    paths = tuple(outputs.of(file).values())
    try:
        if is_video(file.name):
            video = outputs.video(file, rows)
            with local_copy(file.readable_path()) as source:
                sha256 = video_checksum(video, source, request.options)
            kept = video.reusable_row(request.plan.out, sha256, origin)
            if kept is None:
                video.guard(overwrite=request.options.overwrite)
        else:
            picture = outputs.picture(file, rows)
            data = read_input(picture.input)
            check(data, safe_name(file.path), request.options.max_pixels)
            sha256 = hashlib.sha256(data).hexdigest()
            points = request.options.points_for(file, paths, shares_stem=picture.shares_stem)
            kept = picture.reusable_row(request.plan.out, sha256, origin, points)
            if kept is None:
                picture.guard(overwrite=request.options.overwrite)
    except (InputError, OutputError) as error:
        return DryRunResult(file.name, "fail", paths, str(error))
    return DryRunResult(file.name, "keep" if kept else "do", paths)
