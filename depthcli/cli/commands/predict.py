"""``depthcli predict``: the command and its options."""

from __future__ import annotations

import typer

from depthcli.cli import options
from depthcli.cli.groups import Given, group
from depthcli.cli.screen import console
from depthcli.core.options import Eye, one_line
from depthcli.errors import ExitCode, UsageError
from depthcli.io.formats.table import Format, WriterOptions


@group
class OutputOptions:
    """Output."""

    out: str | None = options.usual(
        "Output file (for one input), folder (existing, or ending in '/'), or '-' for "
        "stdout. Default: next to each input.",
        "-o",
        "--out",
        metavar="OUT",
    )
    formats: list[Format] | None = options.usual(
        "Output format; repeatable. Default: from the suffix of -o, else png16 and preview.",
        "--format",
    )
    sidecar: options.SidecarOption = False
    overwrite: options.OverwriteOption = False


def predict(
    images: list[str] = typer.Argument(
        ..., metavar="IMG...", help="Input images or URIs; '-' reads from stdin."
    ),
    *,
    output: OutputOptions,
    model: options.ModelOptions,
    camera: options.CameraOptions,
    anchors: options.FitOptions,
    read: options.ImageOptions,
    eye: Eye | None = typer.Option(
        None,
        rich_help_panel="Reading images",
        help="Image to use from a stereo camera's JPEG (MPO). Default: the first.",
    ),
    detail: options.MapOptions,
    writing: WriterOptions,
    screen: options.ScreenOptions,
    explicit: Given,
) -> int:
    """Estimate depth from one or more images.

    By default, writes a 16-bit PNG in millimetres and a preview next to each image.

    Exit codes: 0 success, 1 some inputs failed, 2 usage error, 3 model error.
    """
    from depthcli.cli import parse
    from depthcli.io.storage.paths import safe_name
    from depthcli.jobs import predict as job
    from depthcli.jobs.outputs import STDIO
    from depthcli.jobs.predict import PredictRequest, image_destination, split_own_outputs

    to_stdout = output.out == STDIO
    if screen.as_json and to_stdout:
        raise UsageError("-o - and --json both write to stdout; name a file with -o")
    destination = image_destination(output.out, output.formats or (), sidecar=output.sidecar)
    sources, skipped = split_own_outputs(images)
    request = PredictRequest(
        images=tuple(sources),
        destination=destination,
        overwrite=output.overwrite,
        model=parse.session_loader(model.model, model.runtime),
        **parse.map_options(camera, anchors, read, detail, writing, eye=eye),
    )
    results = job.predict(request)
    unused = parse.unused_by_outputs(explicit, destination.wanted, request.writing)
    of_depthcli = [f"{safe_name(name)} was written by depthcli; skipped" for name in skipped]
    screen.warn_all([*request.warnings, *unused, *of_depthcli])
    from depthcli.cli.screen.results import print_result
    from depthcli.jobs.image import FailedInput

    failed = []
    for result in results:
        print_result(result, screen, to_stderr=to_stdout)
        if isinstance(result, FailedInput):
            failed.append(one_line(result.name))
    if failed and len(sources) > 1:
        console.note(f"{len(failed)} of {len(sources)} inputs failed: {', '.join(failed)}")
    return ExitCode.SOME_FAILED if failed else ExitCode.OK
