"""Choosing the depth map among the outputs of a graph."""

import re
from typing import Any

from depthcli.core.text import one_line
from depthcli.errors import ModelError
from depthcli.inference.runtime import ort
from depthcli.models.catalog import Model

_NUMBERS = re.compile(r"tensor\((double|u?int\d+|float\d*)\)")
_NAMES = frozenset({"depth", "disparity", "predicted_depth", "metric_depth"})
_RANKS = (0, 3, 4)  # 0: of no stated shape
_IMAGE_RANK = 4


def map_output(session: ort.InferenceSession, model: Model) -> str:
    """Name of the output that is the depth map.

    It is the one that the card names, else the only one that has a map's shape or, of several, the
    only one that is called depth, disparity, predicted_depth or metric_depth.

    Raises:
        ModelError: there is no such output, several could be meant, or it holds no numbers.
    """
    outputs: list[Any] = session.get_outputs()
    wanted = model.card.onnx.output
    found = outputs
    if wanted is not None:
        found = [one for one in outputs if one.name == wanted]
    elif len(outputs) > 1:
        found = [one for one in outputs if _may_be_map(one.type, one.shape)] or outputs
        if len(found) > 1:
            found = [one for one in found if one.name in _NAMES]
    if len(found) != 1 and outputs:
        listed = one_line(", ".join(f"{one.name} {one.shape}" for one in outputs))
        which = "which of them is the depth map" if wanted is None else "one of them"
        raise ModelError(
            f"{model.path} has the outputs {listed}; state {which} in the card, as onnx.output"
        )
    gives = found[0].type if found else "nothing"
    if not _NUMBERS.fullmatch(gives):
        raise ModelError(f"{model.path} gives {gives}, not numbers; use a depth model")
    return str(found[0].name)


def _may_be_map(kind: str, shape: list[Any]) -> bool:
    """Whether it is numbers of shape (N, h, w), (N, 1, h, w) or (N, h, w, 1), as far as stated."""
    if not _NUMBERS.fullmatch(kind) or len(shape) not in _RANKS:
        return False
    return len(shape) != _IMAGE_RANK or any(
        length == 1 or not isinstance(length, int) for length in (shape[1], shape[3])
    )
