"""State that differs between the processes of a run: random number generators, image pools."""

from typing import Any

import torch

from depthcli.training.methods.base import Method

_ACCELERATORS = {"cuda": torch.cuda, "mps": torch.mps}


def process_state(method: Method, device: torch.device) -> dict[str, Any]:
    """The state of this process, on the CPU, by the checkpoint's keys."""
    accelerator = _ACCELERATORS.get(device.type)
    return {
        "rng": torch.get_rng_state(),
        "device_rng": accelerator.get_rng_state(device) if accelerator else None,
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
    accelerator, saved = _ACCELERATORS.get(device.type), state["device_rng"]
    # The states of different kinds of accelerators, between which a run can move, differ in size.
    if accelerator and saved is not None and len(saved) == len(accelerator.get_rng_state(device)):
        accelerator.set_rng_state(saved, device)
