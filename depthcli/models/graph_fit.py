"""Comparing a card's input size with that of the ONNX graph."""

from dataclasses import replace
from pathlib import Path

from depthcli.errors import ModelError
from depthcli.models.card import Fit, ModelCard

_NEEDS_DYNAMIC = {Fit.LOWER_BOUND, Fit.UPPER_BOUND}


def fit_to_graph(
    card: ModelCard, fixed_size: tuple[int | None, int | None], path: Path, *, adapt: bool
) -> ModelCard:
    """Compare a card with the input's (height, width) in the graph; None where that is dynamic.

    With ``adapt`` the graph's size replaces the card's, for networks that are exported at several
    sizes. Pictures are then stretched to it if the card has a dynamic size.

    Raises:
        ModelError: the card states another size.
    """
    spec = card.input
    height, width = fixed_size[0] or spec.height, fixed_size[1] or spec.width
    same = (height, width) == (spec.height, spec.width)
    if fixed_size == (None, None) or (same and (not spec.dynamic or spec.fit is Fit.STRETCH)):
        return card
    if not adapt:
        raise ModelError(
            f"{path} takes pictures of {width} x {height} pixels only; set input.width to {width}, "
            f"input.height to {height} and input.dynamic to false in the card"
        )
    pixel_aspect = spec.pixel_aspect
    if spec.fit is Fit.STRETCH:  # the aspect of the training pictures is the same
        pixel_aspect *= (spec.width * height) / (spec.height * width)
    return replace(
        card,
        input=replace(
            spec,
            width=width,
            height=height,
            dynamic=False,
            fit=Fit.STRETCH if spec.fit in _NEEDS_DYNAMIC else spec.fit,
            pixel_aspect=pixel_aspect,
        ),
    )
