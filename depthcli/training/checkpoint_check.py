"""What a checkpoint has to hold before anything is built from it; files come from anywhere."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch

from depthcli.core.text import shown

_MAX_HFOV_DEG = 180.0


class _Rule(NamedTuple):
    """What a field is, in words and as a test."""

    what: str
    holds: Callable[[Any], bool]


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < 2**63


def _is_number(value: object) -> bool:
    return type(value) is float or _is_count(value)


def _is_between(value: Any, low: float, high: float) -> bool:  # noqa: ANN401
    return _is_number(value) and low < value < high


def _is_texts(value: object) -> bool:
    return isinstance(value, (list, tuple)) and all(isinstance(item, str) for item in value)


def _is_scores(value: object) -> bool:
    return isinstance(value, dict) and all(
        isinstance(name, str) and _is_number(score) for name, score in value.items()
    )


_COUNT = _Rule("a whole number from 0 up", _is_count)
_TEXT = _Rule("text", lambda value: isinstance(value, str))
_TEXTS = _Rule("a list of texts", _is_texts)
_PROGRESS = {
    "step": _COUNT,
    "epoch": _COUNT,
    "threads": _COUNT,
    "seconds": _Rule("a number from 0 up", lambda value: _is_between(value, -1e-9, math.inf)),
    "scores": _Rule("numbers by name", _is_scores),
    "train_ids": _TEXTS,
    "held_out_ids": _TEXTS,
    "data": _TEXT,
    "extra": _TEXT,
    "start": _TEXT,
    "hfov_deg": _Rule(
        "a number between 0 and 180, or nothing",
        lambda value: value is None or _is_between(value, 0, _MAX_HFOV_DEG),
    ),
    "aspect": _Rule("a number above 0", lambda value: _is_between(value, 0, math.inf)),
}


def check_progress(progress: Mapping[str, object]) -> None:
    """Accept what a checkpoint says of its run.

    Raises:
        ValueError: a field is of another type or out of range; the message names it.
    """
    for name, value in progress.items():
        rule = _PROGRESS.get(name)
        if rule is not None and not rule.holds(value):
            raise ValueError(f"progress.{name} has to be {rule.what}, not {shown(value)}")


def check_state(name: str, state: object) -> None:
    """Accept the weights of a checkpoint, tensors by name, which messages call ``name``.

    Raises:
        ValueError: they are something else, or a number among them is not finite.
    """
    if not isinstance(state, dict):
        raise ValueError(  # noqa: TRY004 - one kind of error for all of a file
            f"{name} has to be tensors by name, not {shown(state)}"
        )
    for key, tensor in state.items():
        if not (isinstance(key, str) and isinstance(tensor, torch.Tensor)):
            raise ValueError(  # noqa: TRY004 - as above
                f"{name} has to be tensors by name, not {shown({key: tensor})}"
            )
        if not bool(tensor.isfinite().all()):
            raise ValueError(f"{name}: {key} holds numbers that are not finite")
