"""``depthcli batch``: the command and its options."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from depthcli.cli import options
from depthcli.cli.options import not_negative
from depthcli.core.options import GPU_BATCH, MAX_PIXELS, Upsampling
from depthcli.core.progress import Progress
from depthcli.errors import ExitCode, UsageError
from depthcli.io.formats.table import Format
from depthcli.io.manifest.row import ManifestFormat
from depthcli.jobs.batch.threads import Engine

if TYPE_CHECKING:
    from depthcli.jobs.batch.plan import Plan


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
    from depthcli.jobs.batch.ray import RayEngine

    engine = RayEngine(
        given["ray_address"],
        workers=given["workers"],
        cpus=given["cpus_per_worker"] or 1,
        gpus=given["gpus_per_worker"] or 0,
        progress=progress,
    )
    with closing(engine):
        yield engine


app = typer.Typer(rich_markup_mode=None)

_GRACE_PERIOD_S = 10.0
"""Time to finish the current pictures after a signal."""

STDIO = "-"


@app.command()
def batch(
    context: typer.Context,
    folder: Annotated[
        str | None,
        typer.Argument(metavar="[DIR]", help="Input folder or URI, searched recursively."),
    ] = None,
    output: Annotated[
        str,
        typer.Option(
            "-o",
            "--out",
            "--output",
            metavar="OUT",
            help="Output folder, required; keeps the folder structure of DIR.",
        ),
    ] = "",
    files: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="File with one input path per line, relative to DIR or to the working "
            "directory, '-' for stdin; or a .parquet, .csv or .tsv file with a column of paths.",
        ),
    ] = None,
    column: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Column of a Parquet or CSV list. Default: its only column, or 'path'.",
        ),
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="I/N",
            help="Process part I of N, chosen by a hash of each name; the parts can run at the "
            "same time, on any machines, into one OUT.",
        ),
    ] = None,
    include: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GLOB", help="Process only matching files ('*.jpg', 'left/**'); repeatable."
        ),
    ] = None,
    exclude: Annotated[
        list[str] | None,
        typer.Option(metavar="GLOB", help="Skip matching files and folders; repeatable."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would be done without writing anything.")
    ] = False,
    formats: Annotated[
        list[Format] | None,
        typer.Option("--format", help="Output format; repeatable. Default: png16."),
    ] = None,
    model: options.ModelOption = None,
    provider: options.ProviderOption = "auto",
    provider_option: options.ProviderSettingsOption = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1024,
            help="Pictures processed in parallel; on Ray, processes. Default: one per core.",
        ),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1024,
            help="Inference threads per worker. Default: cores / workers; on Ray, CPUs per worker.",
        ),
    ] = None,
    batch_size: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1024,
            help="Pictures of equal size per inference. Default: 1 on the CPU, 8 on other "
            "providers.",
        ),
    ] = None,
    manifest: Annotated[
        ManifestFormat | None,
        typer.Option(
            help="Format of the manifest: JSON lines, or Parquet for millions of inputs. Default: "
            "that of the manifest in OUT, else jsonl."
        ),
    ] = None,
    max_failures: Annotated[
        str | None,
        typer.Option(
            metavar="N|N%",
            help="Stop when more than N inputs have failed, or more than N% of the last 100 that "
            "were processed (at the beginning, too: after more than N failures). Default: never.",
        ),
    ] = None,
    engine: Annotated[
        EngineName, typer.Option(help="What processes the inputs: this process, or a Ray cluster.")
    ] = EngineName.THREADS,
    ray_address: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Ray cluster: HOST:PORT, ray://HOST:PORT, or 'local' to start one. Default: "
            "RAY_ADDRESS, or the cluster this machine belongs to.",
        ),
    ] = None,
    cpus_per_worker: Annotated[
        float | None,
        typer.Option(
            min=0.01, callback=not_negative, help="CPUs of each worker on Ray. Default: 1."
        ),
    ] = None,
    gpus_per_worker: Annotated[
        float | None,
        typer.Option(
            min=0,
            callback=not_negative,
            help="GPUs of each worker on Ray, 0.25 for a quarter. Default: 0.",
        ),
    ] = None,
    png_scale: options.PngScaleOption = None,
    png_normalize: options.PngNormalizeOption = False,
    exr_channel: options.ExrChannelOption = options.ExrChannel.Y,
    half: options.HalfOption = False,
    colormap: options.ColormapOption = None,
    near: options.NearOption = None,
    vmin: options.VminOption = None,
    vmax: options.VmaxOption = None,
    legend: options.LegendOption = False,
    side_by_side: options.SideBySideOption = False,
    sidecar: options.SidecarOption = False,
    focal_px: options.FocalPxOption = None,
    hfov: options.HfovOption = None,
    cameras: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="CSV file with the camera of each input: column id, its path from DIR with or "
            "without suffix; focal_px or hfov_deg; and optionally cx and cy, the principal point.",
        ),
    ] = None,
    centre_px: options.CentrePxOption = None,
    calibration: options.CalibrationOption = None,
    rectified: options.RectifiedOption = False,
    anchor: options.AnchorOption = None,
    anchors: options.AnchorsOption = None,
    anchors_scale: options.AnchorsScaleOption = None,
    white_level: options.WhiteLevelOption = None,
    exposure: options.ExposureOption = 0.0,
    layer: options.LayerOption = None,
    upsample: options.UpsampleOption = Upsampling.GUIDED,
    tile: options.TileOption = None,
    max_pixels: options.MaxPixelsOption = MAX_PIXELS,
    as_json: options.JsonOption = False,
    quiet: options.QuietOption = False,
) -> int:
    """Estimate depth for all pictures and videos in a folder tree, or in a list.

    Resumes an interrupted run. Writes OUT/manifest.jsonl with one row per input.

    Exit codes: 0 success, 1 some inputs failed, 2 usage error, 3 model error.
    """
    from depthcli.cli.checks import PICTURE_OPTIONS, refuse_for_folder, refuse_unused
    from depthcli.cli.parse import (
        choose_anchors,
        choose_camera,
        choose_detail,
        read_options,
        session_loader,
        writer_options,
    )
    from depthcli.core.parallel import share_cores
    from depthcli.jobs.batch.options import FailureBudget

    writing = writer_options(context.params)
    camera = choose_camera(context.params)
    known = choose_anchors(anchor, anchors, anchors_scale, is_folder=True)
    chosen = [*(formats or [Format.PNG16]), *([Format.JSON] if sidecar else [])]
    refuse_unused(context, chosen, PICTURE_OPTIONS)
    if files is None:
        refuse_for_folder(context)
    detail = choose_detail(upsample, tile)
    budget = FailureBudget.parse(max_failures) if max_failures is not None else None
    plan = _plan(context.params)
    if engine == EngineName.RAY:
        threads = threads or max(1, int(cpus_per_worker or 1))
        batch_size = batch_size or (GPU_BATCH if gpus_per_worker else None)
    else:
        workers, threads = share_cores(workers, threads)
    loader = session_loader(model, provider, threads, provider_option)
    # The driver of a cluster need not have the workers' GPUs.
    here = session_loader(model, "cpu", threads, None) if engine == EngineName.RAY else loader
    loading = here.start()
    from depthcli.cli.process import graceful_shutdown
    from depthcli.cli.screen.results import BatchScreen, StopOnSignal, print_dry_run
    from depthcli.jobs.batch.options import BatchOptions, BatchRequest

    chosen = list(dict.fromkeys(chosen))
    wanted = BatchOptions(
        formats=tuple(chosen),
        writing=writing,
        camera=camera,
        anchors=known,
        reading=read_options(context.params),
        detail=detail,
        max_pixels=max_pixels,
    )
    request = BatchRequest(plan, wanted, loader, workers, batch_size, manifest, budget)
    if dry_run:
        from depthcli.jobs.batch.run import dry_run as run_dry

        would_fail = print_dry_run(run_dry(request, loading.result()), plan, as_json=as_json)
        return ExitCode.SOME_FAILED if would_fail else ExitCode.OK
    from depthcli.jobs.batch.run import Batch

    session = loading.result()
    with graceful_shutdown(_GRACE_PERIOD_S, session.stop) as interrupt:
        stop = StopOnSignal(interrupt)
        with open_engine(context.params, stop) as engine_in_use:
            job = Batch(request, session, engine_in_use, progress=stop)
            BatchScreen(as_json=as_json, quiet=quiet).run(job, plan, stop)
    return ExitCode.SOME_FAILED if job.tally.failures else ExitCode.OK


def _plan(given: Mapping[str, Any]) -> Plan:
    """The plan of the options.

    Args:
        given: values of the options by parameter name.
    """
    from depthcli.io.listing.folder import NameFilter
    from depthcli.io.listing.path_list import parse_list, read_list
    from depthcli.io.manifest.files import WHOLE, Shard
    from depthcli.jobs.batch.plan import plan_files, plan_folder, read_cameras

    folder, out, files, column = (given[name] for name in ("folder", "output", "files", "column"))
    shard = Shard.parse(given["shard"]) if given["shard"] else WHOLE
    if not out:
        raise UsageError("name the folder for outputs: --out OUT")
    wanted = NameFilter.of(given["include"] or (), given["exclude"] or ())
    if column is not None and files in (None, STDIO):
        raise UsageError("--column is for a Parquet or CSV file; name it with --files")
    cameras = read_cameras(given["cameras"]) if given["cameras"] is not None else None
    if files is not None:
        words = parse_list(_stdin()) if files == STDIO else read_list(files, column)
        return plan_files(words, files, folder, out, wanted, shard, cameras)
    if folder is None:
        raise UsageError("name a folder, or give --files with a list")
    return plan_folder(folder, out, wanted, shard, cameras)


def _stdin() -> bytes:
    try:
        return sys.stdin.buffer.read()
    except OSError as error:
        raise UsageError(f"cannot read the list from standard input: {error.strerror}") from error
