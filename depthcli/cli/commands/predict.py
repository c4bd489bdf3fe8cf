"""``depthcli predict`` and ``calibrate``: the commands on images, and their options."""

import json
from pathlib import Path

import typer

from depthcli.cli import groups, options, parse
from depthcli.cli.screen import console
from depthcli.core.options import Eye, one_line
from depthcli.errors import ExitCode, UsageError
from depthcli.io.formats.table import Format, WriterOptions


@groups.group
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
    explicit: groups.Given,
) -> int:
    """Estimate depth from one or more images.

    By default, writes a 16-bit PNG in millimetres and a preview next to each image.

    Exit codes: 0 success, 1 some inputs failed, 2 usage error, 3 model error.
    """
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


@groups.group
class KnownOptions(options.KnownDepthOptions):
    """Known depth."""

    pairs: Path | None = options.option(
        "Folder with images in rgb/ and depth files of the same names in depth/, in place of IMG; "
        "integers are millimetres if the files do not state another unit.",
        metavar="DIR",
    )
    known_object: str | None = options.option(
        "Object of known height that faces the camera: its box in pixels and its height in metres. "
        "Needs --focal-px or --hfov.",
        "--object",
        metavar="X0,Y0,X1,Y1,METRES",
    )


def calibrate(
    name: str = typer.Argument(..., metavar="NAME", help="Name of the camera."),
    images: list[str] | None = typer.Argument(
        None, metavar="[IMG...]", help="Images of the camera."
    ),
    *,
    truth: KnownOptions,
    camera: options.LensOptions,
    model: options.ModelOptions,
    screen: options.ScreenOptions,
) -> int:
    """Measure the scale of a model's metres for a camera, and keep it under a name.

    'predict', 'batch', 'video' and 'serve' use it with --camera NAME. For several images,
    --anchors is a folder with known depth for each.
    """
    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.calibration import keep_camera
    from depthcli.jobs.calibrate import CalibrationRequest, KnownObject, calibrate as measure

    seen_by, count = parse.camera(camera), len(images or ())
    anchors = parse.known_depth(truth, seen_by, is_folder=count > 1)
    sources = [truth.pairs is not None, bool(anchors), truth.known_object is not None]
    if sum(sources) != 1:
        raise UsageError("", "give one of {anchor}, {anchors}, {pairs} and {known_object}")
    if (truth.pairs is None) == (count == 0):
        raise UsageError("", "name images of the camera, or a folder of {pairs}")
    if count > 1 and not truth.anchors:
        raise UsageError("", "{anchor} and {known_object} are for one image")
    known_object = None
    if truth.known_object is not None:
        form = ("X0,Y0,X1,Y1,METRES", "310,120,360,420,1.75", _is_object)
        known_object = KnownObject(*parse.numbers(truth.known_object, *form, "known_object"))
    request = CalibrationRequest(
        name,
        pipeline=Pipeline(parse.session_loader(model.model, model.runtime).load()),
        images=tuple(images or ()),
        pairs=truth.pairs,
        anchors=anchors,
        known_object=known_object,
        camera=seen_by,
    )
    done = measure(request)
    scale = done.scale
    path = keep_camera(scale, done.camera)
    if screen.as_json:
        facts = json.loads(path.read_bytes()) | {"before": done.before, "file": str(path)}
        console.out_json(facts | {"warnings": list(done.warnings)})
    elif not screen.quiet:
        left_out = "" if scale.residual is None else f", {scale.residual:.1%} on points left out"
        error = f"; error {done.before:.1%} before{left_out}"
        shift = f", shift {scale.shift_m:+.3f} m" if scale.shift_m else ""
        source = f"known depths: {scale.points}, images: {scale.images}"
        summary = f"scale {scale.scale:.4f}{shift} for model {scale.model}"
        console.out(f"{name} -> {path}  {summary}, {source}{error}")
        console.warn_all(done.warnings)
    return ExitCode.OK


def _is_object(x0: float, y0: float, x1: float, y1: float, height_m: float) -> bool:
    return x0 < x1 and y0 < y1 and height_m > 0
