"""How a card's preprocessing was verified; if it is wrong, depth is wrong without an error."""

from collections.abc import Mapping
from dataclasses import dataclass

from depthcli.core.types import DepthKind
from depthcli.models.card import ModelCard

_KEY = "preprocessing"
_ALIGN = {
    DepthKind.METRIC: "",
    DepthKind.RELATIVE: " --align depth",
    DepthKind.INVERSE: " --align disparity",
}


@dataclass(frozen=True, slots=True)
class PreprocessingCheck:
    """How a card's size, colours, mean and deviation were verified."""

    #: whether the real weights were run with them on pictures of known depth
    run_with_weights: bool
    verified: str  #: how, one sentence


def preprocessing_check(card: ModelCard) -> PreprocessingCheck | None:
    """The check that a card states under ``training``; None if it states none."""
    stated = card.training.get(_KEY)
    if not isinstance(stated, Mapping):
        return None
    ran, verified = stated.get("run_with_weights"), stated.get("verified")
    if not isinstance(ran, bool) or not isinstance(verified, str):
        return None
    return PreprocessingCheck(ran, verified)


def check_command(card: ModelCard) -> str:
    """The command that compares a model with known depth on a few pictures."""
    return (
        f"depthcli eval nyu --data NYU --split val --limit 20 --model {card.name}"
        + (_ALIGN[card.output.kind])
    )
