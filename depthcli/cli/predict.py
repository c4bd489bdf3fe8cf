"""``depthcli predict``: the command and its options."""

from __future__ import annotations

from typing import Annotated

import typer

from depthcli.cli.numbers import field_of_view, finite, positive
from depthcli.cli.predict_choices import Colormap, ExrChannel, Format, Near
from depthcli.errors import UsageError

app = typer.Typer(rich_markup_mode=None)

MILLIMETRES = 1000.0


@app.command()
def predict(
    images: Annotated[
        list[str], typer.Argument(metavar="IMG...", help="Pictures; '-' reads one from stdin.")
    ],
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--output",
            metavar="OUT",
            help="A file (one input), a folder (it exists, or the name ends in '/'), or '-' for "
            "stdout. Default: beside each input.",
        ),
    ] = None,
    formats: Annotated[
        list[Format] | None,
        typer.Option(
            "--format",
            help="What to write; repeatable. Default: what -o's suffix says, else png16 and "
            "preview.",
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(help="Name ('depthcli models list'), .onnx file, or folder with a card.json."),
    ] = None,
    provider: Annotated[
        str,
        typer.Option(
            help="auto, cpu, cuda, tensorrt, rocm, migraphx, directml, coreml or openvino. One "
            "asked for by name has to be there."
        ),
    ] = "auto",
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of the network. Default: all cores.")
    ] = None,
    png_scale: Annotated[
        float | None,
        typer.Option(
            callback=positive,
            help="Steps a metre in png16: 1000 (default, mm), 256 (KITTI), 5000 (TUM), "
            "4000 (Matterport).",
        ),
    ] = None,
    png_normalize: Annotated[
        bool, typer.Option("--png-normalize", help="Stretch each png16 to 1-65535; no unit.")
    ] = False,
    exr_channel: Annotated[
        ExrChannel, typer.Option(help="Name of the channel in EXR.")
    ] = ExrChannel.Z,
    half: Annotated[bool, typer.Option("--half", help="16-bit floats in EXR.")] = False,
    colormap: Annotated[Colormap, typer.Option(help="Colours of the preview.")] = Colormap.INFERNO,
    near: Annotated[
        Near, typer.Option(help="What near looks like: warm, or for gray white or black.")
    ] = Near.WARM,
    vmin: Annotated[
        float | None,
        typer.Option(
            callback=finite, help="Depth at the preview's near end. Default: percentile 2."
        ),
    ] = None,
    vmax: Annotated[
        float | None,
        typer.Option(
            callback=finite, help="Depth at the preview's far end. Default: percentile 98."
        ),
    ] = None,
    legend: Annotated[
        bool, typer.Option("--legend", help="Draw a scale beside the preview.")
    ] = False,
    side_by_side: Annotated[
        bool, typer.Option("--side-by-side", help="Put the picture beside its preview.")
    ] = False,
    sidecar: Annotated[
        bool, typer.Option("--sidecar", help="Also write a .json with unit, scale, kind, model.")
    ] = False,
    focal_px: Annotated[
        float | None,
        typer.Option(
            callback=positive,
            help="Focal length of the camera in pixels of the picture; scales metres.",
        ),
    ] = None,
    hfov: Annotated[
        float | None,
        typer.Option(
            callback=field_of_view,
            help="Horizontal field of view in degrees, in place of --focal-px. Default: the "
            "picture's EXIF, else the model's own camera.",
        ),
    ] = None,
    anchor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,METRES",
            help="A point whose depth is known; repeatable. One fits the scale, two or more scale "
            "and shift.",
        ),
    ] = None,
    max_pixels: Annotated[
        int, typer.Option(min=1, help="Refuse pictures with more pixels than this.")
    ] = 250_000_000,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object a line for each input, on stdout.")
    ] = False,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
) -> int:
    """Depth of one or several pictures.

    Without options, writes a 16-bit PNG in millimetres and a preview beside each picture.

    Exit code 0 if all was done, 1 if some inputs failed, 2 for wrong usage, 3 if the model failed.
    """
    from depthcli.cli.anchors import parse_anchors
    from depthcli.cli.engine import Engine
    from depthcli.cli.predict_outputs import STANDARD, Looks, choose_formats, plan_jobs

    to_stdout = output == STANDARD
    _refuse(focal_px is not None and hfov is not None, "give --focal-px or --hfov, not both")
    _refuse(
        png_normalize and png_scale is not None, "give --png-scale or --png-normalize, not both"
    )
    _refuse(as_json and to_stdout, "-o - and --json both want stdout; name a file with -o")
    _refuse(vmin is not None and vmin == vmax, "--vmin and --vmax are equal; spread them")
    looks = Looks(
        png_scale=MILLIMETRES if png_scale is None else png_scale,
        png_normalize=png_normalize,
        exr_channel=exr_channel.value,
        half=half,
        colormap=colormap.value,
        near=near.value,
        vmin=vmin,
        vmax=vmax,
        legend=legend,
        side_by_side=side_by_side,
    )
    chosen = choose_formats(output, formats or ())
    jobs = plan_jobs(images, output, chosen, sidecar=sidecar)
    anchors = parse_anchors(anchor or ())
    loading = Engine(model, provider, threads).start()
    from depthcli.cli.predict_run import Camera, Predictor, Voice

    predictor = Predictor(
        loading=loading,
        camera=Camera(focal_px, hfov, anchors),
        looks=looks,
        max_pixels=max_pixels,
        voice=Voice(as_json=as_json, quiet=quiet, to_stderr=to_stdout),
    )
    return predictor.run(jobs)


def _refuse(wrong: bool, message: str) -> None:
    if wrong:
        raise UsageError(message)
