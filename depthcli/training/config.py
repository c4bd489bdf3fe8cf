"""Everything that decides a training run, as one tree of frozen dataclasses.

A configuration is built from a method's defaults, then files that hold only differences (TOML),
then ``a.b=c`` settings; unknown names and ill-typed values are refused. Checkpoints carry it.
"""

from __future__ import annotations

import ast
import dataclasses
import tomllib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from depthcli.core.codec import DepthCodec
from depthcli.errors import UsageError
from depthcli.training.config_range import check_range

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class GeneratorConfig:
    """The generator G and, where a method has one, the backward generator F.

    Attributes:
        name: ``resnet`` is the paper's, ``efficient`` the one that ships.
        width: channels of the first layer of ``resnet``.
        blocks: residual blocks of ``resnet``.
        residual: final residual connection of ``resnet``: stem features, input, or none.
        antialias: blur when ``resnet`` changes resolution (the CUT family).
        encoder: channels of ``efficient`` at strides 2, 4, 8, 16, 32.
        decoder: channels of ``efficient`` at strides 16, 8, 4, 2.
        depths: residual blocks of ``efficient`` at strides 4, 8, 16, 32.
        dropout: share of bottleneck channels of ``efficient`` dropped while training.
    """

    name: Literal["resnet", "efficient"] = "resnet"
    width: int = 64
    blocks: int = 9
    residual: Literal["none", "stem", "input"] = "stem"
    antialias: bool = False
    encoder: tuple[int, ...] = (32, 64, 128, 192, 256)
    decoder: tuple[int, ...] = (128, 96, 64, 48)
    depths: tuple[int, ...] = (2, 2, 2, 2)
    dropout: float = 0.0


@dataclass(frozen=True, slots=True)
class OutputConfig:
    """How depth is coded for the networks.

    Attributes:
        coding: ``linear`` maps [0, max_m] to [-1, 1] (the paper), ``log`` maps [min_m, max_m].
        min_m: nearest depth of the log coding, metres; also the clip of the exported model.
        max_m: farthest depth, metres.
    """

    coding: Literal["linear", "log"] = "linear"
    min_m: float = 0.4
    max_m: float = 10.0

    @property
    def codec(self) -> DepthCodec:
        """The mapping between raw outputs and metres."""
        if self.coding == "linear":
            return DepthCodec.linear_m(self.max_m)
        return DepthCodec.log_m(self.min_m, self.max_m)


@dataclass(frozen=True, slots=True)
class DataConfig:
    """What the networks are shown.

    Attributes:
        width: network input width, px.
        height: network input height, px.
        colour: ``value`` is V of HSV (the paper), ``luma`` Rec. 601.
        paired: pictures and depth maps of one scene point together; False draws them apart.
        crop_286: resize to 286/256 of the size and crop, as the originals do; untrue to metres.
        zoom: largest zoom-in; depth is divided by the zoom, so metres stay true.
        rotate_deg: largest rotation about the optical axis, degrees.
        colour_jitter: standard deviation of the log gain of each colour channel.
        gamma: standard deviation of the log gamma of V.
        brightness: standard deviation of the log gain of V.
        noise: largest standard deviation of pixel noise, in [0, 1] units.
        holdout_every: every n-th scene by name is held out for validation; 0 holds out none.
        holdout_offset: the first of them.
    """

    width: int = 256
    height: int = 256
    colour: Literal["value", "luma"] = "value"
    paired: bool = True
    crop_286: bool = False
    zoom: float = 1.0
    rotate_deg: float = 0.0
    colour_jitter: float = 0.0
    gamma: float = 0.0
    brightness: float = 0.0
    noise: float = 0.0
    holdout_every: int = 7
    holdout_offset: int = 3


@dataclass(frozen=True, slots=True)
class LossConfig:
    """Weights and variants of the losses; a weight of zero also leaves its networks out.

    A method has some of them (``Method.TERMS``); the others have to be zero.

    Attributes:
        adversarial: λ1, both directions.
        contrast_x: λ2, NCE of x and G(x); hDCE for HnegSRC.
        contrast_y: λ3, NCE of y and G(y); of y and F(y) for DCLGAN and SimDCL.
        identity: λ4, eq. 3.
        cycle: λ5, eq. 2.
        l1: λ6, eq. 1; zero is the unpaired ablation.
        weight_penalty: λ of eq. 1, on squared convolution weights.
        gradient: multi-scale gradient matching, beyond the paper.
        gan: form of the adversarial terms.
        contrast: ``cut`` compares output with input, ``cfl`` output with paired truth.
        l1_backward: also hold F to the paired picture by eq. 1.
        flip_contrast: half of the steps mirror the input of G (FastCUT).
        relation: λ of the semantic relations' consistency (HnegSRC).
        gamma_start: γ of HnegSRC's negatives at the first step.
        gamma_end: γ at the last step; linear in between.
        similarity: weight of the domains' similarity (SimDCL).
    """

    adversarial: float = 1.0
    contrast_x: float = 0.5
    contrast_y: float = 0.5
    identity: float = 5.0
    cycle: float = 10.0
    l1: float = 10.0
    weight_penalty: float = 1e-6
    gradient: float = 0.0
    gan: Literal["lsgan", "hinge", "ralsgan"] = "lsgan"
    contrast: Literal["cut", "cfl"] = "cut"
    l1_backward: bool = False
    flip_contrast: bool = False
    relation: float = 0.0
    gamma_start: float = 50.0
    gamma_end: float = 10.0
    similarity: float = 0.0


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
        head_learning_rate: of the patch heads of DCLGAN and SimDCL; 0 is ``learning_rate``.
        head_beta1: Adam's first, of those heads.
        head_beta2: Adam's second, of those heads.
    """

    batch_size: int = 1
    epochs_constant: int = 100
    epochs_decay: int = 100
    schedule: Literal["linear", "cosine"] = "linear"
    warmup_steps: int = 0
    learning_rate: float = 2e-4
    beta1: float = 0.5
    beta2: float = 0.999
    weight_decay: float = 0.0
    clip_norm: float = 0.0
    ema: float = 0.0
    pool_size: int = 50
    width_discriminator: int = 64
    head_learning_rate: float = 0.0
    head_beta1: float = 0.5
    head_beta2: float = 0.999

    @property
    def epochs(self) -> int:
        """Epochs of the whole run."""
        return self.epochs_constant + self.epochs_decay


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """One training run, whole.

    Attributes:
        method: name of the method.
        seed: of weights, order and augmentation.
        validate_every: epochs from one validation to the next; the last is always validated.
        save_every: epochs from one checkpoint to the next; a run that stops always writes one.
        precision: Fabric's name of it: ``32-true``, ``bf16-mixed`` or ``16-mixed``.
    """

    method: str = "proposed"
    seed: int = 0
    validate_every: int = 1
    save_every: int = 1
    precision: Literal["32-true", "bf16-mixed", "16-mixed"] = "32-true"
    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    output: OutputConfig = field(default_factory=OutputConfig)
    data: DataConfig = field(default_factory=DataConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optim: OptimConfig = field(default_factory=OptimConfig)


def resolve(base: TrainConfig, files: Iterable[Path], settings: Iterable[str]) -> TrainConfig:
    """Apply files of differences, then ``a.b=c`` settings, to a base configuration.

    Raises:
        UsageError: a name is unknown, a value has the wrong type or is out of range, or a file is
            not TOML.
    """
    for file in files:
        try:
            base = updated(base, tomllib.loads(file.read_text("utf-8")))
        except (OSError, ValueError) as error:
            raise UsageError(f"cannot read the configuration {file}: {error}") from None
    for setting in settings:
        base = updated(base, _nested(setting))
    check_range(base)
    return base


def updated(config: T, changes: Mapping[str, Any]) -> T:
    """A copy with some fields changed; nested mappings change nested configurations."""
    hints = get_type_hints(type(config))
    values: dict[str, Any] = {}
    for name, value in changes.items():
        if name not in hints:
            known = ", ".join(hints)
            raise UsageError(f"unknown setting '{name}'; choose from {known}")
        old = getattr(config, name)
        if dataclasses.is_dataclass(old):
            if not isinstance(value, dict):
                raise UsageError(f"'{name}' is a group; set {name}.SETTING=VALUE")
            values[name] = updated(old, value)
        else:
            values[name] = _checked(name, value, hints[name])
    return dataclasses.replace(config, **values)  # type: ignore[type-var]


def _nested(setting: str) -> dict[str, Any]:
    key, equals, text = setting.partition("=")
    if not equals:
        raise UsageError(f"'{setting}' is not of the form a.b=value")
    words = {"true": True, "false": False}
    try:
        value = words[text.lower()] if text.lower() in words else ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError):
        value = text
    *outer, last = key.split(".")
    nested: dict[str, Any] = {last: value}
    for part in reversed(outer):
        nested = {part: nested}
    return nested


def _checked(name: str, value: Any, hint: Any) -> Any:  # noqa: ANN401
    if get_origin(hint) is Literal:
        if value not in get_args(hint):
            raise UsageError(f"{name} is one of {', '.join(get_args(hint))}, not {value!r}")
        return value
    if get_origin(hint) is tuple:
        if isinstance(value, (list, tuple)) and all(type(item) is int for item in value):
            return tuple(value)
        raise UsageError(f"{name} is a list of whole numbers, not {value!r}")
    if hint is float and type(value) is int:
        return float(value)
    if type(value) is not hint:
        raise UsageError(f"{name} is of type {hint.__name__}, not {value!r}")
    return value
