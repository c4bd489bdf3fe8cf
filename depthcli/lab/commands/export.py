"""``depthcli export-onnx``: exporting a checkpoint to an ONNX file with its card."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import typer

from depthcli.cli import options as groups
from depthcli.cli.groups import group
from depthcli.cli.screen import console
from depthcli.errors import ExitCode, UsageError
from depthcli.lab.commands.options import WeightsOption
from depthcli.lab.options import Weights


@group
class NetworkOptions:
    """Network."""

    weights: WeightsOption = Weights.AVERAGED
    fp16: bool = groups.option("Store weights as float16; computes in float32.", default=False)
    int8: Path | None = groups.option(
        "Quantize to int8, calibrated and checked on the images in DIR.", metavar="DIR"
    )
    opset: int = groups.option("ONNX opset version.", default=17, min=16, max=20)
    tolerance: float | None = groups.option(
        "Maximum difference from torch. Default: 0.001, with --fp16 0.02, with --int8 0.2.",
        callback=groups.not_negative,
    )


@group
class CardOptions:
    """Model card."""

    name: str = groups.usual("Model name in the card.", "--name", default="custom", metavar="NAME")
    model_version: str = groups.option(
        "Model version in the card.", default="1.0.0", metavar="VERSION"
    )
    license_name: str = groups.option(
        "SPDX license identifier of the weights, for the card.", "--license", default="NOASSERTION"
    )
    hfov: float | None = groups.option(
        "Horizontal field of view of the training images in degrees, if the run does not know it.",
        callback=groups.field_of_view,
    )
    depth_factor: float = groups.option(
        "Factor on depth, which corrects a bias that was measured on held-out images.",
        default=1.0,
        callback=groups.positive,
        metavar="FACTOR",
    )
    focal_exponent: float = groups.option(
        "Power of the ratio of focal lengths by which metres follow an image's camera, as measured "
        "on crops of held-out images (docs/cameras.md).",
        default=1.0,
        callback=groups.positive,
        metavar="POWER",
    )
    float_model: str | None = groups.option(
        "With --int8: name of the same model in floats, for GPUs and OpenVINO.",
        metavar="NAME",
    )


def export_onnx(
    checkpoint: Path = typer.Argument(
        ..., metavar="CKPT", help="Checkpoint written by depthcli train, or its folder."
    ),
    out: Path | None = typer.Option(
        None,
        "-o",
        "--out",
        metavar="OUT",
        help="Output ONNX file or folder. Default: next to the checkpoint.",
    ),
    *,
    network: NetworkOptions,
    card: CardOptions,
    screen: groups.ScreenOptions,
) -> int:
    """Export a checkpoint to ONNX, verify it against torch, and write its model card.

    Nothing is written if torch and onnxruntime disagree by more than the tolerance.
    """
    from depthcli.lab.export.onnx import ExportOptions, export_checkpoint
    from depthcli.lab.training.checkpoint import CHECKPOINT

    if network.fp16 and network.int8 is not None:
        raise UsageError("", "give {fp16} or {int8}, not both")
    if card.float_model is not None and network.int8 is None:
        raise UsageError("", "{float_model} is for {int8}: a float model runs on every provider")
    options = ExportOptions(**vars(network), **vars(card))
    if checkpoint.is_dir():
        checkpoint /= CHECKPOINT
    path = checkpoint.with_suffix(".onnx") if out is None else out
    path = path if path.suffix.lower() == ".onnx" else path / "model.onnx"
    done = export_checkpoint(checkpoint, path, options)
    written, parity, sizes = done.card, done.parity, len(done.parity.cases)
    if screen.as_json:
        facts = {"path": str(done.path), "sha256": written.sha256, "bytes": written.size_bytes}
        console.out_json(facts | dataclasses.asdict(parity))
    elif not screen.quiet:
        console.out(
            f"{done.path}  {(written.size_bytes or 0) / 1e6:.1f} MB  sha256 {written.sha256}\n"
            f"parity at {sizes} size{'s' * (sizes != 1)}: max {parity.max_abs:.2g}, "
            f"mean {parity.mean_abs:.2g} (allowed {parity.tolerance:g})"
        )
    return ExitCode.OK
