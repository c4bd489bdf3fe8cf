"""``depthcli export-onnx``: a checkpoint to one ONNX file and its card."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer reads the annotations
from typing import Annotated

import typer

from depthcli.cli import console
from depthcli.cli.numbers import field_of_view, not_negative
from depthcli.core.extras import INSTALL_TRAIN
from depthcli.errors import DepthcliError, ExitCode, UsageError

app = typer.Typer(rich_markup_mode=None)


@app.command()
def export_onnx(
    checkpoint: Annotated[Path, typer.Argument(metavar="CKPT", help="Written by depthcli train.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="ONNX file, or a folder. Default: beside the checkpoint."
        ),
    ] = None,
    name: Annotated[str, typer.Option(help="Name of the model in its card.")] = "custom",
    model_version: Annotated[str, typer.Option(help="Version in the card.")] = "1.0.0",
    fp16: Annotated[
        bool, typer.Option("--fp16", help="Weights as float16: half the file, float32 sums.")
    ] = False,
    int8: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Weights and activations as int8, calibrated and checked on the pictures of DIR.",
        ),
    ] = None,
    mirror: Annotated[
        bool, typer.Option("--mirror", help="Average with the mirrored picture, at twice the cost.")
    ] = False,
    opset: Annotated[int, typer.Option(min=16, max=20, help="ONNX operator set.")] = 17,
    tolerance: Annotated[
        float | None,
        typer.Option(
            callback=not_negative,
            help="Largest difference from torch in the raw output. Default: 0.001, with --fp16 "
            "0.02, with --int8 0.2.",
        ),
    ] = None,
    license_name: Annotated[
        str, typer.Option("--license", help="Licence of the weights in the card, an SPDX name.")
    ] = "NOASSERTION",
    hfov: Annotated[
        float | None,
        typer.Option(
            callback=field_of_view,
            help="Horizontal field of view of the training pictures in degrees, for the card. "
            "Default: NYU's, if they are NYU's.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> int:
    """Export a checkpoint to ONNX, check it against torch, and write its card beside it.

    Nothing is written if torch and onnxruntime disagree by more than the tolerance.
    """
    try:
        from depthcli.export.onnx import ExportOptions, export_checkpoint
    except ImportError as error:
        raise DepthcliError(f"export needs {error.name}: {INSTALL_TRAIN}") from error
    if fp16 and int8 is not None:
        raise UsageError("--fp16 and --int8 exclude each other; give one")
    options = ExportOptions(
        name, model_version, fp16, mirror, opset, tolerance, int8, license_name, hfov
    )
    done = export_checkpoint(checkpoint, _target(checkpoint, output), options)
    parity = done.parity
    if as_json:
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
    else:
        console.out(
            f"{done.path}  {(done.card.size_bytes or 0) / 1e6:.1f} MB  sha256 {done.card.sha256}\n"
            f"parity over {len(parity.cases)} sizes: max {parity.max_abs:.2g}, "
            f"mean {parity.mean_abs:.2g} (allowed {parity.tolerance:g})"
        )
    return ExitCode.OK


def _target(checkpoint: Path, output: Path | None) -> Path:
    if output is None:
        return checkpoint.with_suffix(".onnx")
    return output if output.suffix == ".onnx" else output / "model.onnx"
