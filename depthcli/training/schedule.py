"""Learning-rate factors."""

import math

from depthcli.training.config import OptimConfig


def linear_factor(epoch: int, constant: int, decay: int) -> float:
    """1 for ``constant`` epochs, then linearly towards zero: 1 − max(0, e+1−c)/(d+1)."""
    return 1.0 - max(0, epoch + 1 - constant) / (decay + 1)


def cosine_factor(step: int, steps: int) -> float:
    """Half a cosine from 1 to 0 over ``steps``."""
    return 0.5 * (1.0 + math.cos(math.pi * min(step, steps) / steps))


def lr_factor(optim: OptimConfig, step: int, steps_per_epoch: int) -> float:
    """Factor on the learning rate at a step, counted from 0 over the whole run.

    The schedule's factor, multiplied by a linear ramp over the first ``optim.warmup_steps``.
    """
    warmup = optim.warmup_steps
    ramp = min(1.0, (step + 1) / warmup) if warmup else 1.0
    if optim.schedule == "linear":
        epoch = step // steps_per_epoch
        return ramp * linear_factor(epoch, optim.epochs_constant, optim.epochs_decay)
    return ramp * cosine_factor(step, optim.epochs * steps_per_epoch)
