"""The part of a configuration that says what is minimised, and how."""

from dataclasses import dataclass, field, fields
from typing import Literal

from depthcli.training.config.rules import Amount, Count, Positive, Share, Small, WholeShare, Width

_TERM = "term"


def _weighs(loss: str = "") -> dict[str, str]:
    """What marks the weight of a term.

    ``loss`` is ``module:function`` of ``depthcli/training/losses/`` where the term is no more than
    a comparison of a depth map with its truth; see :mod:`~depthcli.training.losses.paired`.
    """
    return {_TERM: loss}


@dataclass(frozen=True, slots=True)
class LossConfig:
    """Weights and variants of the losses; a weight of zero also leaves its networks out.

    A method has some of them (``Method.TERMS``); the others have to be zero.

    Attributes:
        adversarial: λ1.
        contrast_x: λ2, NCE of x and G(x); hDCE for HnegSRC.
        contrast_y: λ3, NCE of y and G(y); of y and F(y) for DCLGAN and SimDCL.
        identity: λ4, eq. 3.
        cycle: λ5, eq. 2.
        l1: λ6, eq. 1; zero is the unpaired ablation.
        weight_penalty: λ of eq. 1, on squared convolution weights.
        gradient: multi-scale gradient matching, beyond the paper.
        extra_scale: how much of an extra pair's error in scale counts, in [0, 1]: 0 leaves relative
            depth alone, 1 holds the networks to its metres.
        gan: form of the adversarial terms.
        adversarial_backward: judge F's pictures too, not G's depth maps alone.
        contrast: ``cut`` compares output with input, ``cfl`` output with paired truth.
        l1_backward: hold F to the paired picture by eq. 1, too.
        flip_contrast: half of the steps mirror the input of G (FastCUT).
        relation: λ of the semantic relations' consistency (HnegSRC).
        gamma_start: γ of HnegSRC's negatives at the first step.
        gamma_end: γ at the last step; linear in between.
        similarity: weight of the domains' similarity (SimDCL).
    """

    adversarial: Amount = field(default=1.0, metadata=_weighs())
    contrast_x: Amount = field(default=0.5, metadata=_weighs())
    contrast_y: Amount = field(default=0.5, metadata=_weighs())
    identity: Amount = field(default=5.0, metadata=_weighs())
    cycle: Amount = field(default=10.0, metadata=_weighs())
    l1: Amount = field(default=10.0, metadata=_weighs())
    weight_penalty: Amount = 1e-6
    gradient: Amount = field(default=0.0, metadata=_weighs("gradient:gradient_loss"))
    extra_scale: WholeShare = 0.0
    gan: Literal["lsgan", "hinge", "ralsgan"] = "lsgan"
    adversarial_backward: bool = True
    contrast: Literal["cut", "cfl"] = "cut"
    l1_backward: bool = False
    flip_contrast: bool = False
    relation: Amount = field(default=0.0, metadata=_weighs())
    gamma_start: Small = 50.0
    gamma_end: Small = 10.0
    similarity: Amount = field(default=0.0, metadata=_weighs())


_PLACES = {f.name: str(f.metadata[_TERM]) for f in fields(LossConfig) if _TERM in f.metadata}
TERMS = tuple(_PLACES)
"""Weights of ``LossConfig`` that make a term of their own."""
PAIRED_LOSSES = {name: place for name, place in _PLACES.items() if place}
"""Those that compare a depth map with its truth, with ``module:function`` of each loss."""


@dataclass(frozen=True, slots=True)
class OptimConfig:
    """How the networks are moved.

    Attributes:
        batch_size: pictures a step.
        epochs_constant: epochs at the full learning rate (``linear`` schedule).
        epochs_decay: epochs of linear decay to zero, or all epochs of ``cosine``.
        schedule: ``linear`` is the paper's, ``cosine`` starts with a warm-up.
        warmup_steps: steps of linear warm-up of ``cosine``.
        learning_rate: at the full rate.
        beta1: Adam's first.
        beta2: Adam's second.
        weight_decay: decoupled, on matrices and kernels only.
        clip_norm: largest gradient norm of the generators; 0 does not clip.
        ema: decay of the weight average that is validated and exported; 0 keeps none.
        pool_size: image pool of the discriminators; 0 has none.
        width_discriminator: first layer of the discriminators.
        head_learning_rate: of the heads of DCLGAN and SimDCL; 0 is ``learning_rate`` and its betas,
            as SimDCL has it.
        head_beta1: Adam's first, of those heads.
        head_beta2: Adam's second, of those heads.
    """

    batch_size: Positive = 1
    epochs_constant: Count = 100
    epochs_decay: Count = 100
    schedule: Literal["linear", "cosine"] = "linear"
    warmup_steps: Count = 0
    learning_rate: Amount = 2e-4
    beta1: Share = 0.5
    beta2: Share = 0.999
    weight_decay: Amount = 0.0
    clip_norm: Amount = 0.0
    ema: Share = 0.0
    pool_size: Count = 50
    width_discriminator: Width = 64
    head_learning_rate: Amount = 0.0
    head_beta1: Share = 0.5
    head_beta2: Share = 0.999

    @property
    def epochs(self) -> int:
        """Epochs of the whole run."""
        return self.epochs_constant + self.epochs_decay
