"""Stopping at losses or weights that are not finite."""

import math

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from depthcli.errors import TrainingError

_ADVICE = (
    "lower optim.learning_rate or use precision=32-true, and go on from the last checkpoint, "
    "which is kept"
)


def finite_losses(losses: dict[str, Tensor], fabric: Fabric) -> dict[str, float]:
    """The loss terms as floats, averaged over the processes, in one transfer from the device.

    Raises:
        TrainingError: one of them is not finite; the message names it.
    """
    together = torch.stack([term.detach().float() for term in losses.values()])
    if fabric.world_size > 1:
        together = fabric.all_reduce(together, reduce_op="mean")  # type: ignore[assignment]
    values = dict(zip(losses, together.tolist(), strict=True))
    for name, value in values.items():
        if not math.isfinite(value):
            raise TrainingError(f"the loss term '{name}' became {value}", _ADVICE)
    return values


def check_weights(method: nn.Module, step: int) -> None:
    """Check the weights before they are saved: a finite loss can have a gradient that is not.

    Raises:
        TrainingError: a weight is not finite; the message names its network and the step.
    """
    for name, network in method.named_children():
        whole = [weight.isfinite().all() for weight in network.state_dict().values()]
        if whole and not bool(torch.stack(whole).all()):
            raise TrainingError(f"a weight of '{name}' is not finite after step {step}", _ADVICE)
