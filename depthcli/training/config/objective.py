"""Configuration of losses and optimization."""

from dataclasses import dataclass, field, fields
from typing import Literal

from depthcli.training.config.rules import (
    Amount,
    Count,
    Positive,
    PositiveFloat,
    Share,
    UnitInterval,
    Width,
)

_TERM = "term"


def _weighs(loss: str = "") -> dict[str, str]:
    """Field metadata that marks the weight of a loss term.

    ``loss`` is ``module:function`` in ``depthcli/training/losses/`` for terms that only compare a
    depth map with its ground truth; see :mod:`~depthcli.training.losses.paired`.
    """
    return {_TERM: loss}


@dataclass(frozen=True, slots=True)
class LossConfig:
    """Weights and variants of the losses; with a weight of zero, its networks are not built.

    A method uses some of them (``Method.TERMS``); the others have to be zero.
    """

    adversarial: Amount = field(default=1.0, metadata=_weighs())  #: λ1
    #: λ2, NCE of x and G(x); hDCE for HnegSRC
    contrast_x: Amount = field(default=0.5, metadata=_weighs())
    #: λ3, NCE of y and G(y); of y and F(y) for DCLGAN and SimDCL
    contrast_y: Amount = field(default=0.5, metadata=_weighs())
    identity: Amount = field(default=5.0, metadata=_weighs())  #: λ4, eq. 3
    cycle: Amount = field(default=10.0, metadata=_weighs())  #: λ5, eq. 2
    #: λ6, eq. 1; zero is the unpaired ablation
    l1: Amount = field(default=10.0, metadata=_weighs())
    weight_penalty: Amount = 1e-6  #: λ of eq. 1, on squared convolution weights
    #: multi-scale gradient matching, beyond the paper
    gradient: Amount = field(default=0.0, metadata=_weighs("gradient:gradient_loss"))
    #: weight of the error in scale of pseudo labels: with 0 they supervise relative depth only,
    #: with 1 metres too; a view mixed by ``data.cutmix`` has one scale for both its pictures
    pseudo_label_scale: UnitInterval = 0.0
    gan: Literal["lsgan", "hinge", "ralsgan"] = "lsgan"  #: form of the adversarial terms
    adversarial_backward: bool = True  #: also a discriminator for F's pictures
    #: ``cut`` compares output with input, ``cfl`` output with paired truth
    contrast: Literal["cut", "cfl"] = "cut"
    l1_backward: bool = False  #: also eq. 1 between F's output and the paired picture
    flip_contrast: bool = False  #: half of the steps mirror the input of G (FastCUT)
    #: λ of semantic relation consistency (HnegSRC)
    relation: Amount = field(default=0.0, metadata=_weighs())
    gamma_start: PositiveFloat = 50.0  #: γ of HnegSRC's negatives at the first step
    gamma_end: PositiveFloat = 10.0  #: γ at the last step; linear in between
    #: weight of the reconstruction of hidden blocks (masked)
    reconstruction: Amount = field(default=0.0, metadata=_weighs())
    hidden: Share = 0.55  #: probability that a block of a picture is hidden (masked)
    #: weight of the similarity loss (SimDCL)
    similarity: Amount = field(default=0.0, metadata=_weighs())


_TERM_LOSSES = {f.name: str(f.metadata[_TERM]) for f in fields(LossConfig) if _TERM in f.metadata}
TERMS = tuple(_TERM_LOSSES)
"""Weights of ``LossConfig`` that have a loss term."""
PAIRED_LOSSES = {name: place for name, place in _TERM_LOSSES.items() if place}
"""Those that compare a depth map with its truth, with ``module:function`` of each loss."""


@dataclass(frozen=True, slots=True)
class OptimConfig:
    """Optimizers, schedule and batch size."""

    batch_size: Positive = 1  #: pictures per step
    epochs_constant: Count = 100  #: epochs at the full learning rate of ``linear``
    epochs_decay: Count = 100  #: epochs of linear decay to zero
    #: ``linear`` is the paper's; ``cosine`` falls from the first epoch to the last of both counts
    schedule: Literal["linear", "cosine"] = "linear"
    warmup_steps: Count = 0  #: steps over which the learning rate rises from zero at first
    learning_rate: Amount = 2e-4  #: before decay
    beta1: Share = 0.5  #: Adam's first
    beta2: Share = 0.999  #: Adam's second
    weight_decay: Amount = 0.0  #: decoupled, on matrices and kernels only
    clip_norm: Amount = 0.0  #: largest gradient norm of the generators; 0 does not clip
    ema: Share = 0.0  #: decay of the weight average that is validated and exported; 0 keeps none
    pool_size: Count = 50  #: image pool of the discriminators; 0 has none
    width_discriminator: Width = 64  #: first layer of the discriminators
    #: of the heads of DCLGAN and SimDCL; 0 is ``learning_rate`` and its betas, as SimDCL has it
    head_learning_rate: Amount = 0.0
    head_beta1: Share = 0.5  #: Adam's first, of those heads
    head_beta2: Share = 0.999  #: Adam's second, of those heads

    @property
    def epochs(self) -> int:
        """Epochs of the whole run."""
        return self.epochs_constant + self.epochs_decay
