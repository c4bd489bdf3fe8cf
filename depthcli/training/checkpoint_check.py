"""What a checkpoint has to hold before anything is built from it; files come from anywhere."""

from typing import Any

import torch

from depthcli.core.foreign import FieldError

_DEEPEST = 16


def check_tensors(name: str, state: object) -> None:
    """Accept tensors by name, those of networks say.

    Raises:
        FieldError: they are something else, or a number among them is not finite.
    """
    if not isinstance(state, dict):
        raise FieldError.unless("tensors by name", state).within(name)
    for key, tensor in state.items():
        if not (isinstance(key, str) and isinstance(tensor, torch.Tensor)):
            raise FieldError.unless("tensors by name", {key: tensor}).within(name)
        check_finite(f"{name}: {key}", tensor)


def check_finite(name: str, state: Any, depth: int = 0) -> None:  # noqa: ANN401
    """Accept what optimisers and pools keep: tensors, numbers and words, in lists and groups.

    Raises:
        FieldError: there is something else, or a number is not finite.
    """
    if depth > _DEEPEST:
        raise FieldError(f"{name} is nested too deeply")
    # A view of one number can be as large as it says, and take as much memory to look at.
    if isinstance(state, torch.Tensor) and state.nbytes > state.untyped_storage().nbytes():
        raise FieldError(f"{name} is larger than what the file holds of it")
    match state:
        case torch.Tensor() | float():
            if not bool(torch.as_tensor(state).isfinite().all()):
                raise FieldError(f"{name} holds numbers that are not finite")
        case dict() | list() | tuple():
            for part in state.values() if isinstance(state, dict) else state:
                check_finite(name, part, depth + 1)
        case None | bool() | int() | str():
            pass
        case _:
            raise FieldError.unless("tensors and numbers", state).within(name)


def check_process(state: dict[str, Any]) -> None:
    """Accept what one process of a run keeps for itself: chance and image pools.

    Raises:
        FieldError: it is something else.
    """
    for name in ("rng", "device_rng"):
        rng = state[name]
        is_state = isinstance(rng, torch.Tensor) and rng.dtype == torch.uint8 and rng.ndim == 1
        if not is_state and not (name == "device_rng" and rng is None):
            raise FieldError.unless("the state of a generator", rng).within(name)
        check_finite(name, rng)
    if not isinstance(state["extra"], dict):
        raise FieldError.unless("image pools by name", state["extra"]).within("extra")
    for name, images in state["extra"].items():
        if not isinstance(images, list) or not all(map(_is_image, images)):
            raise FieldError.unless("a list of pictures", images).within(name)
        check_finite(str(name), images)


def _is_image(image: object) -> bool:
    return isinstance(image, torch.Tensor) and image.ndim == 3 and image.is_floating_point()  # noqa: PLR2004
