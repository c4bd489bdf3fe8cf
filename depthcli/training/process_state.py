"""State that differs between the processes of a run: random number generators, image pools."""

from typing import Any

import torch

from depthcli.training.methods.base import Method


def process_state(method: Method, device: torch.device) -> dict[str, Any]:
    """The state of this process, on the CPU, by the checkpoint's keys."""
    return {
        "rng": torch.get_rng_state(),
        "device_rng": torch.cuda.get_rng_state(device) if device.type == "cuda" else None,
        "extra": {
            name: [image.cpu() for image in images] for name, images in method.extra_state().items()
        },
    }


def load_process_state(method: Method, device: torch.device, state: dict[str, Any]) -> None:
    """Restore a state returned by :func:`process_state`."""
    method.load_extra_state(
        {name: [image.to(device) for image in images] for name, images in state["extra"].items()}
    )
    torch.set_rng_state(state["rng"])
    if device.type == "cuda" and state["device_rng"] is not None:
        torch.cuda.set_rng_state(state["device_rng"], device)
