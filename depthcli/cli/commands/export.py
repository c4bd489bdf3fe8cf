"""``depthcli export-onnx``: exporting a checkpoint to an ONNX file with its card."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.options import QuietOption, WeightsOption, field_of_view, not_negative
from depthcli.cli.screen import console
from depthcli.core.options import Weights
from depthcli.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from depthcli.export.onnx import ExportResult

app = typer.Typer(rich_markup_mode=None)


@app.command()
def export_onnx(
    checkpoint: Annotated[
        Path,
        typer.Argument(metavar="CKPT", help="Checkpoint written by depthcli train, or its folder."),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="OUT",
            help="Output ONNX file or folder. Default: next to the checkpoint.",
        ),
    ] = None,
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="Model name in the card.")
    ] = "custom",
    model_version: Annotated[
        str, typer.Option(metavar="VERSION", help="Model version in the card.")
    ] = "1.0.0",
    fp16: Annotated[
        bool, typer.Option("--fp16", help="Store weights as float16; computes in float32.")
    ] = False,
    int8: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Quantize weights and activations to int8, calibrated and checked on the "
            "pictures in DIR.",
        ),
    ] = None,
    mirror: Annotated[
        bool,
        typer.Option(
            "--mirror",
            help="Average with the prediction for the mirrored picture; doubles the cost.",
        ),
    ] = False,
    opset: Annotated[int, typer.Option(min=16, max=20, help="ONNX opset version.")] = 17,
    tolerance: Annotated[
        float | None,
        typer.Option(
            callback=not_negative,
            help="Maximum difference from torch in the raw output. Default: 0.001, with --fp16 "
            "0.02, with --int8 0.2.",
        ),
    ] = None,
    license_name: Annotated[
        str, typer.Option("--license", help="SPDX license identifier of the weights, for the card.")
    ] = "NOASSERTION",
    hfov: Annotated[
        float | None,
        typer.Option(
            callback=field_of_view,
            help="Horizontal field of view of the training pictures in degrees, for the card. "
            "Only if the run does not know its camera: NYU's and that of cameras.csv are known.",
        ),
    ] = None,
    float_model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="With --int8: name of the same model in floats, for the card; it is used in "
            "place of this one on GPUs and OpenVINO.",
        ),
    ] = None,
    weights: WeightsOption = Weights.AVERAGED,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object to stdout.")
    ] = False,
    quiet: QuietOption = False,
) -> int:
    """Export a checkpoint to ONNX, verify it against torch, and write its model card.

    Nothing is written if torch and onnxruntime disagree by more than the tolerance.
    """
    from depthcli.export.onnx import ExportOptions, export_checkpoint
    from depthcli.training.checkpoint import CHECKPOINT

    if fp16 and int8 is not None:
        raise UsageError("--fp16 and --int8 exclude each other; give one")
    if float_model is not None and int8 is None:
        raise UsageError("--float-model needs --int8: a float model runs on every provider itself")
    options = ExportOptions(
        name,
        model_version,
        fp16,
        mirror,
        opset,
        tolerance,
        int8,
        license_name,
        hfov,
        float_model,
        weights,
    )
    if checkpoint.is_dir():
        checkpoint /= CHECKPOINT
    done = export_checkpoint(checkpoint, _export_path(checkpoint, output), options)
    if as_json:
        _print_export_json(done)
    elif not quiet:
        _print_export(done)
    return ExitCode.OK


def _export_path(checkpoint: Path, output: Path | None) -> Path:
    if output is None:
        return checkpoint.with_suffix(".onnx")
    return output if output.suffix.lower() == ".onnx" else output / "model.onnx"


def _print_export(done: ExportResult) -> None:
    card, parity, sizes = done.card, done.parity, len(done.parity.cases)
    console.report(
        f"{done.path}  {(card.size_bytes or 0) / 1e6:.1f} MB  sha256 {card.sha256}\n"
        f"parity at {sizes} size{'s' * (sizes != 1)}: max {parity.max_abs:.2g}, "
        f"mean {parity.mean_abs:.2g} (allowed {parity.tolerance:g})"
    )


def _print_export_json(done: ExportResult) -> None:
    parity = done.parity
    console.out_json(
        {
            "path": str(done.path),
            "sha256": done.card.sha256,
            "bytes": done.card.size_bytes,
            "max_abs": parity.max_abs,
            "mean_abs": parity.mean_abs,
            "tolerance": parity.tolerance,
            "cases": [list(case) for case in parity.cases],
        }
    )
