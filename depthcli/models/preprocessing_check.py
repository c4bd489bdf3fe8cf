"""How a card's preprocessing was verified; a wrong one gives no error, only wrong depth."""

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

    #: whether somebody ran the real weights with them on pictures of known depth
    run_with_weights: bool
    verified: str  #: how, one sentence


def preprocessing_check(card: ModelCard) -> PreprocessingCheck | None:
    """What a card says of it, under ``training``; None if it says nothing."""
    stated = card.training.get(_KEY)
    if not isinstance(stated, Mapping):
        return None
    ran, verified = stated.get("run_with_weights"), stated.get("verified")
    if not isinstance(ran, bool) or not isinstance(verified, str):
        return None
    return PreprocessingCheck(ran, verified)


def command_to_check(card: ModelCard) -> str:
    """The command that compares a model with known depth on a few pictures."""
    return (
        f"depthcli eval nyu --data NYU --split val --limit 20 --model {card.name}"
        + (_ALIGN[card.output.kind])
    )
