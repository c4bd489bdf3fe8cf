"""Validating the contents of a checkpoint, which may come from anywhere, before it is used."""

from typing import Any

import torch

from depthcli.core.validation import FieldError

_MAX_DEPTH = 16


def check_tensors(name: str, state: object) -> None:
    """Check a state dict: tensors by name.

    Raises:
        FieldError: it is something else, or holds a number that is not finite.
    """
    if not isinstance(state, dict):
        raise FieldError.expected("tensors by name", state).within(name)
    for key, tensor in state.items():
        if not (isinstance(key, str) and isinstance(tensor, torch.Tensor)):
            raise FieldError.expected("tensors by name", {key: tensor}).within(name)
        check_finite(f"{name}: {key}", tensor)


def check_finite(name: str, state: Any, depth: int = 0) -> None:  # noqa: ANN401
    """Check the state of optimizers or image pools: nested tensors, numbers and strings.

    Raises:
        FieldError: it holds something else, or a number that is not finite.
    """
    if depth > _MAX_DEPTH:
        raise FieldError(f"{name} is nested too deeply")
    # An expanded view of one number can claim any size, and reading it would take that memory.
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
            raise FieldError.expected("tensors and numbers", state).within(name)


def check_process(state: dict[str, Any]) -> None:
    """Check the state of one process: random number generators and image pools.

    Raises:
        FieldError: it is something else.
    """
    for name in ("rng", "device_rng"):
        rng = state[name]
        is_state = isinstance(rng, torch.Tensor) and rng.dtype == torch.uint8 and rng.ndim == 1
        if not is_state and not (name == "device_rng" and rng is None):
            raise FieldError.expected("the state of a generator", rng).within(name)
        check_finite(name, rng)
    if not isinstance(state["extra"], dict):
        raise FieldError.expected("image pools by name", state["extra"]).within("extra")
    for name, images in state["extra"].items():
        if not isinstance(images, list) or not all(map(_is_image, images)):
            raise FieldError.expected("a list of pictures", images).within(name)
        check_finite(str(name), images)


def _is_image(image: object) -> bool:
    return isinstance(image, torch.Tensor) and image.ndim == 3 and image.is_floating_point()  # noqa: PLR2004
