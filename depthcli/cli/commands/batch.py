"""``depthcli batch`` and ``manifest``: the commands and their options."""

from __future__ import annotations

import sys
from contextlib import closing, nullcontext
from dataclasses import asdict, replace
from itertools import chain
from threading import Event
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from depthcli.cli import options as groups, parse
from depthcli.cli.groups import Given, group
from depthcli.cli.screen import console
from depthcli.core.options import GPU_BATCH, SceneLayout, one_line
from depthcli.core.parallel import Progress, share_cores
from depthcli.errors import ExitCode, UsageError
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.listing import NameFilter, parse_list, read_list
from depthcli.io.manifest import FAILED, WHOLE, Shard, damage, merge_manifests, read_rows, summarize
from depthcli.io.storage.paths import RemotePath, path_of
from depthcli.jobs.batch.plan import BatchPlan, changes_of, plan_files, plan_folder, scene_format

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from depthcli.jobs.batch.ray import RayEngine


_GRACE_PERIOD_S = 10.0  #: time to finish the current images after a signal
_STDIO = "-"


@group
class OutputOptions:
    """Output."""

    out: str = groups.usual(
        "Output folder; keeps the folder structure of DIR.",
        "-o",
        "--out",
        default=...,
        metavar="OUT",
    )
    formats: list[Format] | None = groups.usual(
        "Output format; repeatable. Default: png16.", "--format"
    )
    sidecar: groups.SidecarOption = False
    overwrite: groups.OverwriteOption = False
    dry_run: bool = groups.usual("Show what would be done without writing anything.", default=False)
    layout: SceneLayout | None = groups.option(
        "Write what a program for scenes reads: 3dgs (inverse depth in a.png, with "
        "depth_params.json) or colmap (a.jpg.geometric.bin for stereo/depth_maps). Needs "
        "--anchors in the scene's unit, such as sparse/0."
    )
    transforms: str | None = groups.option(
        "transforms.json of nerfstudio, of which a copy in OUT gets depth_file_path.",
        metavar="FILE",
    )


@group
class InputOptions:
    """Choosing inputs."""

    files: str | None = groups.option(
        "File with one input path per line ('-' for stdin), relative to DIR or to the working "
        "directory; or a .parquet, .csv or .tsv file with a column of paths.",
        metavar="LIST",
    )
    column: str | None = groups.option(
        "Column with the paths of a list (default: the only column, or 'path') or with images in "
        "Parquet; in tar, the part of names after the first dot; in a bag, the topic of the "
        "images (default: the only one).",
        "--column",
        "--topic",
        metavar="NAME",
    )
    shard: str | None = groups.option(
        "Process part I of N, chosen by a hash of each name; the parts can run at the "
        "same time, on any machines, into one OUT.",
        metavar="I/N",
    )
    include: list[str] | None = groups.option(
        "Process only matching files ('*.jpg', 'left/**'); repeatable.", metavar="GLOB"
    )
    exclude: list[str] | None = groups.option(
        "Skip matching files and folders; repeatable.", metavar="GLOB"
    )
    watch: bool = groups.option(
        "When done, wait for new and changed files until interrupted.", default=False
    )


@group
class EngineOptions:
    """Parallel processing."""

    workers: groups.WorkersOption = None
    batch_size: int | None = groups.option(
        "Images of equal size per inference. Default: 1 on the CPU, 8 on other providers.",
        min=1,
        max=groups.MAX_THREADS,
    )
    max_failures: int | None = groups.option(
        "Stop when more than N inputs have failed. Default: never.", min=0
    )
    engine: Literal["threads", "ray"] = groups.option(
        "Where inputs are processed: on this machine, or on a Ray cluster.", default="threads"
    )
    ray_address: str | None = groups.option(
        "Ray cluster: HOST:PORT, ray://HOST:PORT, or 'local' to start one. Default: "
        "RAY_ADDRESS, or the cluster this machine belongs to.",
        metavar="ADDRESS",
    )
    cpus_per_worker: float | None = groups.option(
        "CPUs of each worker on Ray. Default: 1.", min=0.01, callback=groups.not_negative
    )
    gpus_per_worker: float | None = groups.option(
        "GPUs of each worker on Ray, 0.25 for a quarter. Default: 0.",
        min=0,
        callback=groups.not_negative,
    )


@group
class CamerasOptions(groups.CameraOptions):
    """Camera."""

    cameras: str | None = groups.option(
        "CSV file with the camera of each input: columns id (path relative to DIR, with or "
        "without suffix), focal_px or hfov_deg, and optionally cx and cy (principal point).",
        metavar="FILE",
    )


def batch(
    folder: str | None = typer.Argument(
        None,
        metavar="[DIR]",
        help="Input folder or URI, searched recursively; or a data set in one file: a tar shard "
        "(webdataset), Parquet with images inside (Hugging Face), or a bag of ROS 2 (.mcap, .db3).",
    ),
    *,
    output: OutputOptions,
    inputs: InputOptions,
    engine: EngineOptions,
    model: groups.ModelOptions,
    camera: CamerasOptions,
    anchors: groups.FitOptions,
    read: groups.ImageOptions,
    detail: groups.MapOptions,
    writing: WriterOptions,
    screen: groups.ScreenOptions,
    explicit: Given,
) -> int:
    """Estimate depth for all images and videos in a folder tree, or in a list.

    Resumes an interrupted run. Writes OUT/manifest.jsonl with one row per input.

    Exit codes: 0 success, 1 some inputs failed, 2 usage error, 3 model error.
    """
    how = parse.map_options(camera, anchors, read, detail, writing, is_folder=True)
    chosen = _scene_formats(output, how) or output.formats or (Format.PNG16,)
    formats = (*chosen, *([Format.JSON] if output.sidecar else ()))
    changed = _changes(folder, output.out, inputs, camera.cameras)
    plan = _plan(folder, output.out, inputs, camera.cameras)
    threads = model.runtime.threads or max(1, int(engine.cpus_per_worker or 1))
    is_ray = engine.engine == "ray"
    if not is_ray:
        _, threads = share_cores(engine.workers, model.runtime.threads)
    loader = parse.session_loader(model.model, model.runtime, threads)
    # The driver of a cluster need not have the workers' GPUs.
    here = replace(loader, provider="cpu", provider_options={})
    loading = (here if is_ray else loader).start()
    # Imported while the model loads.
    from depthcli.cli.screen import results
    from depthcli.cli.shell import graceful_shutdown
    from depthcli.jobs.batch.run import Batch, BatchRequest, dry_run
    from depthcli.jobs.batch.tasks import BatchOptions

    options = BatchOptions(
        formats=tuple(dict.fromkeys(formats)),
        overwrite=output.overwrite,
        column=inputs.column,
        layout=output.layout,
        transforms=path_of(output.transforms) if output.transforms else None,
        **how,
    )
    on_gpu = is_ray and engine.gpus_per_worker  # this machine need not have it
    request = BatchRequest(
        plan=plan,
        options=options,
        model=loader,
        workers=engine.workers,
        batch_size=engine.batch_size or (GPU_BATCH if on_gpu else None),
        max_failures=engine.max_failures,
        may_spawn=True,
    )
    screen.warn_all(parse.unused_by_outputs(explicit, formats, options.writing))
    if inputs.watch and not (output.dry_run or screen.quiet):
        console.note(f"watching {folder}; Ctrl-C ends")
    if output.dry_run:
        planned = dry_run(request, loading.result())
        would_fail = results.print_dry_run(planned, plan, screen)
        return ExitCode.SOME_FAILED if would_fail else ExitCode.OK
    session = loading.result()
    stopped = Event()

    def on_signal() -> None:
        session.stop()
        stopped.set()

    with graceful_shutdown(_GRACE_PERIOD_S, on_signal) as stop:
        with closing(_cluster(engine, stop)) if is_ray else nullcontext() as cluster:
            for each in chain([plan], changed(stopped)):
                job = Batch(replace(request, plan=each), session, cluster, progress=stop)
                results.run_batch(job, each, stop, screen)
        stop.check()
    return ExitCode.SOME_FAILED if job.tally.failures else ExitCode.OK


def _scene_formats(output: OutputOptions, how: dict[str, Any]) -> tuple[Format, ...]:
    """The formats of a layout, whose options are set; none without a layout."""
    if output.transforms and (output.layout or how["writing"].is_normalized):
        raise UsageError("", "{transforms} needs depth, not inverse: give it without {layout}")
    if output.transforms and Format.PNG16 not in (output.formats or [Format.PNG16]):
        raise UsageError("", "{transforms} needs {format} png16")
    if output.layout is None:
        return ()
    if output.formats or not how["anchors"]:
        raise UsageError("", "{layout} is for {anchors}, and without {format}, which it chooses")

    format_, how["writing"] = scene_format(output.layout, how["writing"])
    return (format_,)


def _changes(
    folder: str | None, out: str, inputs: InputOptions, cameras: str | None
) -> Callable[[Event], Iterator[BatchPlan]]:
    """Plans of new and changed files of the folder; none without ``--watch``."""
    if not inputs.watch:
        return lambda _stop: iter(())
    if folder is None or inputs.files or inputs.shard or cameras:
        raise UsageError("", "{watch} is for a folder, without {files}, {shard} and {cameras}")
    place = path_of(folder)
    if isinstance(place, RemotePath) or not place.is_dir():
        raise UsageError(f"{folder} is not a local folder", option="watch")

    names_filter = NameFilter.of(inputs.include or (), inputs.exclude or ())
    return changes_of(folder, out, names_filter)


def _cluster(options: EngineOptions, progress: Progress) -> RayEngine:
    """The cluster; ``progress`` is called with 0 while it works, and can stop it by raising."""
    from depthcli.jobs.batch.ray import RayEngine

    return RayEngine(
        options.ray_address,
        workers=options.workers,
        cpus=options.cpus_per_worker or 1,
        gpus=options.gpus_per_worker or 0,
        progress=progress,
    )


def _plan(folder: str | None, out: str, inputs: InputOptions, cameras: str | None) -> BatchPlan:
    from depthcli.io.archives import holds_images

    files, column = inputs.files, inputs.column
    shard = WHOLE if inputs.shard is None else Shard.parse(inputs.shard)
    names_filter = NameFilter.of(inputs.include or (), inputs.exclude or ())
    archive = next((x for x in (folder, files) if x and holds_images(path_of(x), column)), None)
    if archive is not None:
        root = str(path_of(archive).parent)
        return plan_files([archive], archive, root, out, names_filter, shard, cameras)
    if files is None and folder is None:
        raise UsageError("", "name a folder, or give a list with {files}")
    if files is None:
        return plan_folder(folder or "", out, names_filter, shard, cameras)
    words = parse_list(sys.stdin.buffer.read()) if files == _STDIO else read_list(files, column)
    return plan_files(words, files, folder, out, names_filter, shard, cameras)


_Manifest = Annotated[
    str, typer.Argument(metavar="OUT", help="Output folder of a batch, or a manifest in it.")
]


def show_summary(out: _Manifest, as_json: groups.JsonOption = False) -> int:
    """Count inputs, failures and outputs, of all shards together."""
    sums = summarize(read_rows(path_of(out)))
    if problem := damage(path_of(out)):
        console.warn(problem)
    lines = [f"{sums.inputs} inputs: {sums.inputs - sums.failed} ok, {sums.failed} failed"]
    lines.append(f"{sums.outputs} outputs, {sums.output_bytes / 1e6:.1f} MB")
    lines.append(f"{sums.seconds:.1f} s of processing time")
    for model in sums.models:
        by = "{inputs} by model {model} ({model_sha256:.12}), depthcli {version}"
        lines.append(by.format_map(model))
    console.show(asdict(sums), *lines, as_json=as_json)
    return ExitCode.OK


def list_failed(out: _Manifest, as_json: groups.JsonOption = False) -> int:
    """List the inputs that failed, each with the reason."""
    for row in read_rows(path_of(out)):
        if row.status == FAILED and as_json:
            console.out_json(row.as_json())
        elif row.status == FAILED:
            console.out(f"{one_line(row.input)}\t{one_line(row.error or '')}")
    return ExitCode.OK


def merge_parts(
    out: str = typer.Argument(..., metavar="OUT", help="Output folder of a batch."),
    as_json: groups.JsonOption = False,
) -> int:
    """Merge the manifests of all shards into one, and remove them."""
    path = str(merge_manifests(path_of(out)))
    console.show({"manifest": path}, f"manifest: {path}", as_json=as_json)
    return ExitCode.OK


MANIFEST = {"summary": show_summary, "failed": list_failed, "merge": merge_parts}
