"""How init weights encode colour and depth, which does not show in their shapes."""

from collections.abc import Sequence
from pathlib import Path

from depthcli.core.codec import Transform
from depthcli.errors import CheckpointError
from depthcli.models.card import ModelCard
from depthcli.models.catalog import find_model
from depthcli.training.checkpoint import Checkpoint
from depthcli.training.config.schema import TrainConfig
from depthcli.training.methods.registry import method_class
from depthcli.training.provenance import value_differences

_CODINGS = {Transform.LINEAR: "linear", Transform.EXP: "log"}


def coding_differences(config: TrainConfig, paths: Sequence[Path]) -> tuple[str, ...]:
    """Settings of colour and depth in which init weights differ from a run, one text each.

    Args:
        config: of the run.
        paths: exported models and checkpoints of the same coding; none is fine.

    Raises:
        CheckpointError: a checkpoint cannot be read.
        ModelError: a model cannot be read.
    """
    return value_differences(_of_file(paths[0]), _of_config(config)) if paths else ()


def check_same_coding(paths: Sequence[Path]) -> None:
    """Check that weights of which the mean is taken encode colour and depth in the same way.

    Raises:
        CheckpointError: they do not, or a checkpoint cannot be read.
        ModelError: a model cannot be read.
    """
    if len(paths) < 2:  # noqa: PLR2004
        return
    first = _of_file(paths[0])
    for path in paths[1:]:
        found = value_differences(_of_file(path), first)
        if found:
            raise CheckpointError(
                f"{path} encodes colour or depth in another way than {paths[0]} "
                f"({'; '.join(found)}), so their weights have no mean: start from one of them"
            )


def _of_file(path: Path) -> dict[str, object]:
    is_model = path.suffix == ".onnx"
    return _of_card(find_model(path).card) if is_model else _of_config(Checkpoint.load(path).config)


def _of_config(config: TrainConfig) -> dict[str, object]:
    colour = {"data.colour": str(config.data.colour)}
    if not method_class(config.method).DEPTH:
        return {**colour}
    return colour | _depth(config.output.coding, config.output.min_m, config.output.max_m)


def _of_card(card: ModelCard) -> dict[str, object]:
    output = card.output
    coding = _CODINGS.get(output.transform, str(output.transform))
    return {"data.colour": str(card.input.colour)} | _depth(coding, output.min_m, output.max_m)


def _depth(coding: str, min_m: float | None, max_m: float | None) -> dict[str, object]:
    """Of the linear coding, ``min_m`` is the clip alone."""
    depth = {"output.coding": coding, "output.max_m": max_m}
    return {**depth, "output.min_m": min_m} if coding == "log" else {**depth}
