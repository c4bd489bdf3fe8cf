"""The configuration of a training run, as a tree of frozen dataclasses; saved in checkpoints.

:mod:`~depthcli.lab.training.settings` applies files and settings to a method's defaults.
"""

# ruff: noqa: RUF009 - weights of terms are fields, too

import math
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from depthcli.core.options import MILLIMETRES, Rule
from depthcli.core.types import DepthCodec, Transform
from depthcli.core.validation import FieldError, merged
from depthcli.errors import UsageError
from depthcli.lab.metrics.depth import METRICS

T = TypeVar("T")
_LEAST_SIDE_PX = 32  # below, discriminators have no output and the gradient loss no coarsest scale
_STRIDE = 4  # exported networks of any kind take multiples of it
_SIDE_STEP_PX = 16  # of views of other aspect ratios
_LEVELS = {
    "resnet": {},
    "efficient": {"encoder": 5, "decoder": 4, "depths": 4},
    "encoder": {"decoder": 4},
}
_PROMPT_LEVELS = 4
_TERM = "term"

_Pattern: TypeAlias = Literal["uniform", "lidar", "camera", "corners"]
Precision: TypeAlias = Literal["32-true", "bf16-mixed", "16-mixed"]
Count: TypeAlias = Annotated[int, Rule("a whole number from 0 up", lambda n: n >= 0)]
Positive: TypeAlias = Annotated[int, Rule("a whole number from 1 up", lambda n: n >= 1)]
Layers: TypeAlias = Annotated[int, Rule("a whole number from 1 to 999", lambda n: 0 < n < 1000)]
Seed: TypeAlias = Annotated[
    int, Rule(f"a whole number from 0 to {2**32 - 1}", lambda n: 0 <= n < 2**32)
]  # as NumPy takes it
Amount: TypeAlias = Annotated[float, Rule("a number from 0 to 1e30", lambda x: 0 <= x <= 1e30)]
Share: TypeAlias = Annotated[float, Rule("a number from 0 to below 1", lambda x: 0 <= x < 1)]
UnitInterval: TypeAlias = Annotated[float, Rule("a number from 0 to 1", lambda x: 0 <= x <= 1)]
Metres: TypeAlias = Annotated[float, Rule("a number above 0", lambda x: x > 0)]
Scale: TypeAlias = Annotated[float, Rule("a number from 0.001 to 1e9", lambda x: 1e-3 <= x <= 1e9)]
Zoom: TypeAlias = Annotated[float, Rule("a number from 1 to 100", lambda x: 1 <= x <= 100)]
Aspect: TypeAlias = Annotated[float, Rule("a number from 1/4 to 4", lambda x: 1 / 4 <= x <= 4)]
MetricName: TypeAlias = Annotated[
    str, Rule(f"one of {', '.join(METRICS)}", lambda name: name in METRICS)
]
Side: TypeAlias = Annotated[
    int, Rule("a multiple of 4 from 32 up", lambda n: n >= _LEAST_SIDE_PX and n % _STRIDE == 0)
]


@dataclass(frozen=True, slots=True)
class GeneratorConfig:
    """The generator G and, where a method has one, the backward generator F."""

    #: ``resnet`` is the paper's, ``efficient`` the one that ships, ``encoder`` has one of timm
    name: Literal["resnet", "efficient", "encoder"] = "resnet"
    width: Positive = 64  #: channels of the first layer of ``resnet``
    blocks: Layers = 9  #: residual blocks of ``resnet``
    residual: Literal["none", "stem", "input"] = "stem"  #: final connection of ``resnet``
    antialias: bool = False  #: blur when ``resnet`` changes resolution (the CUT family)
    #: channels of ``efficient`` at strides 2, 4, 8, 16, 32; of ``encoder``, its name in timm
    encoder: tuple[Positive, ...] | str = (32, 64, 128, 192, 256)
    #: channels of ``efficient`` and ``encoder`` at strides 16, 8, 4, 2
    decoder: tuple[Positive, ...] = (128, 96, 64, 48)
    #: residual blocks of ``efficient`` at strides 4, 8, 16, 32
    depths: tuple[Layers, ...] = (2, 2, 2, 2)
    dropout: Share = 0.0  #: share of bottleneck channels of ``efficient`` dropped while training
    #: of ``efficient`` and ``encoder``: ``batch``, also of depth maps for identity, cycle or
    #: contrast; ``none`` to start from an exported model, where it is folded; ``decoder`` to fold
    #: that of the encoder alone
    norm: Literal["batch", "decoder", "none"] = "batch"
    #: channels at strides 16, 8, 4, 2 of the layers that take known depth, for the method
    #: ``prompted``; empty without them
    prompt: tuple[Positive, ...] = ()


@dataclass(frozen=True, slots=True)
class PromptConfig:
    """Known depth that the method ``prompted`` learns from; each view gets one of the patterns."""

    #: ``uniform`` points, ``lidar`` lines, a depth ``camera`` of few pixels, ``corners`` as of SLAM
    patterns: tuple[_Pattern, ...] = ("uniform", "uniform", "lidar", "camera", "corners")
    points: tuple[Positive, Positive] = (5, 20_000)  #: least and largest number of uniform points
    corners: tuple[Positive, Positive] = (10, 1_000)  #: of corners
    lines: tuple[Positive, ...] = (1, 4, 16, 64)  #: numbers of lidar lines
    columns: tuple[Positive, Positive] = (16, 64)  #: of a depth camera
    range_m: tuple[Metres, Metres] = (2.5, 8.0)  #: beyond which a depth camera sees nothing
    exact: UnitInterval = 0.5  #: share of prompts whose only errors are those of ``jitter_px``
    noise: Share = 0.03  #: largest standard deviation, relative to depth, of half of the others
    kinect: UnitInterval = 0.2  #: share of the others whose noise grows with distance, as Kinect's
    wrong: tuple[Share, ...] = (0.0, 0.02, 0.1, 0.25)  #: shares of wrong points, of the others
    jitter_px: Amount = 0.3  #: standard deviation of the shift of each point, network px
    shift_px: Amount = 2.0  #: largest shift of all points, of a wrong calibration, network px
    shifted: UnitInterval = 0.2  #: share of the others that are shifted
    missing: UnitInterval = 0.2  #: share of prompts that lack a part of the image
    #: standard deviation of errors that are added to the trained network's output, in log depth
    base_errors: Amount = 0.15


@dataclass(frozen=True, slots=True)
class OutputConfig:
    """Coding of depth for the networks."""

    #: ``linear`` maps [0, max_m] to [-1, 1] (the paper), ``log`` maps [min_m, max_m]
    coding: Literal["linear", "log"] = "linear"
    min_m: Metres = 0.4  #: nearest depth of ``log``, and clip of the exported model, metres
    max_m: Metres = 10.0  #: farthest depth, metres

    @property
    def codec(self) -> DepthCodec:
        """The mapping between raw outputs and metres."""
        if self.coding == "linear":
            return DepthCodec(Transform.LINEAR, self.max_m / 2, self.max_m / 2)
        return DepthCodec.log_m(self.min_m, self.max_m)


@dataclass(frozen=True, slots=True)
class DataConfig:
    """Network inputs, augmentation and splits."""

    width: Side = 256  #: network input width, px
    height: Side = 256  #: network input height, px
    #: ``value`` is V of HSV (the paper), ``luma`` Rec. 601; ``rgb`` is for
    #: ``generator.name=resnet``, or ``encoder`` with the losses ``l1`` and ``gradient`` alone
    colour: Literal["value", "luma", "rgb"] = "value"
    paired: bool = True  #: aligned images and depth maps; False samples them independently
    #: enlarge by 286/256, then crop, as the original methods do; metres are not divided by this
    crop_286: bool = False
    zoom: Zoom = 1.0  #: largest zoom-in; depth is divided by the zoom, so metres stay true
    aspects: tuple[Aspect, ...] = ()  #: further width / height of views, in half of the batches
    turn: UnitInterval = 0.0  #: fraction of the views with a rotated camera; the others are crops
    rotate_deg: Amount = 0.0  #: largest rotation about the optical axis, as far as zoom has room
    colour_jitter: Amount = 0.0  #: standard deviation of the log gain of each colour channel
    gamma: Amount = 0.0  #: standard deviation of the log gamma of V
    brightness: Amount = 0.0  #: standard deviation of the log gain of V
    blur: UnitInterval = 0.0  #: largest weight of a binomial filter, in [0, 1]
    border: UnitInterval = 0.0  #: fraction of the views whose border is repeated or painted gray
    noise: Amount = 0.0  #: largest standard deviation of pixel noise, in [0, 1] units
    pseudo_label_share: Share = 0.5  #: fraction of each batch from the pseudo labels, if any
    cutmix: Share = 0.0  #: probability that a view gets a rectangle of another one, depth alike
    split: Literal["paper", "official"] = "paper"  #: of NYU Depth v2, whose training pairs are used
    units_per_metre: Scale = MILLIMETRES  #: of depth in a folder of your own
    holdout_every: Count = 7  #: every n-th scene by name is held out for validation; 0 for none
    holdout_offset: Count = 3  #: index of the first of them

    @property
    def channels(self) -> int:
        """Channels of the network's input."""
        return 3 if self.colour == "rgb" else 1

    def view_sides(self, aspect: float) -> tuple[int, int]:
        """Width and height of views of another aspect ratio, px, with about as many pixels."""
        width = math.sqrt(self.width * self.height * aspect)
        steps = (max(1, round(side / _SIDE_STEP_PX)) for side in (width, width / aspect))
        across, down = (count * _SIDE_STEP_PX for count in steps)
        return across, down


def _term(weight: float, loss: str = "") -> Any:  # noqa: ANN401 - a field
    """The weight of a loss term.

    ``loss`` names the function of :mod:`depthcli.lab.training.losses` for a term that only compares
    prediction and truth (B, 1, H, W), where a mask is valid, or everywhere (None).
    """
    return field(default=weight, metadata={_TERM: loss})


@dataclass(frozen=True, slots=True)
class LossConfig:
    """Weights and variants of the losses; with a weight of zero, its networks are not built.

    A method uses some of them (``Method.TERMS``); the others have to be zero.
    """

    adversarial: Amount = _term(1.0)  #: λ1
    contrast_x: Amount = _term(0.5)  #: λ2, NCE of x and G(x); hDCE for HnegSRC
    contrast_y: Amount = _term(0.5)  #: λ3, NCE of y and G(y); of y and F(y) for DCLGAN and SimDCL
    identity: Amount = _term(5.0)  #: λ4, eq. 3
    cycle: Amount = _term(10.0)  #: λ5, eq. 2
    l1: Amount = _term(10.0)  #: λ6, eq. 1; zero is the unpaired ablation
    weight_penalty: Amount = 1e-6  #: λ of eq. 1, on squared convolution weights
    #: multi-scale gradient matching, beyond the paper
    gradient: Amount = _term(0.0, "gradient_loss")
    #: weight of the error in scale of pseudo labels: 0 for relative depth only, 1 for metres too
    pseudo_label_scale: UnitInterval = 0.0
    gan: Literal["lsgan", "hinge", "ralsgan"] = "lsgan"  #: form of the adversarial terms
    adversarial_backward: bool = True  #: also a discriminator for F's images
    contrast: Literal["cut", "cfl"] = "cut"  #: output against input, or its paired truth
    l1_backward: bool = False  #: also eq. 1 between F's output and the paired image
    flip_contrast: bool = False  #: half of the steps mirror the input of G (FastCUT)
    relation: Amount = _term(0.0)  #: λ of semantic relation consistency (HnegSRC)
    gamma_start: Scale = 50.0  #: γ of HnegSRC's negatives at the first step
    gamma_end: Scale = 10.0  #: γ at the last step; linear in between
    similarity: Amount = _term(0.0)  #: weight of the similarity loss (SimDCL)
    #: losses like ``gradient_loss`` of other packages: weight by ``module:function``
    custom: dict[str, Amount] = field(default_factory=dict)


_TERM_LOSSES = {f.name: str(f.metadata[_TERM]) for f in fields(LossConfig) if _TERM in f.metadata}
TERMS = tuple(_TERM_LOSSES)  #: weights of ``LossConfig`` that have a loss term
PAIRED_LOSSES = {name: loss for name, loss in _TERM_LOSSES.items() if loss}  #: against truth


@dataclass(frozen=True, slots=True)
class OptimConfig:
    """Optimizers, schedule and batch size."""

    batch_size: Positive = 1  #: images per step
    #: parts of a batch whose gradients are computed one after another and added, for less memory
    accumulate: Positive = 1
    epochs_constant: Count = 100  #: epochs at the full learning rate of ``linear``
    epochs_decay: Count = 100  #: epochs of linear decay to zero
    #: ``linear`` is the paper's; ``cosine`` falls from the first epoch to the last of both counts
    schedule: Literal["linear", "cosine"] = "linear"
    warmup_steps: Count = 0  #: steps over which the learning rate rises from zero at first
    learning_rate: Amount = 2e-4  #: before decay
    encoder_rate: UnitInterval = 1.0  #: of ``generator.name=encoder``: its encoder's share of it
    beta1: Share = 0.5  #: Adam's first
    beta2: Share = 0.999  #: Adam's second
    weight_decay: Amount = 0.0  #: decoupled, on matrices and kernels only
    clip_norm: Amount = 0.0  #: largest gradient norm of the generators; 0 does not clip
    ema: Share = 0.0  #: decay of the weight average that is validated and exported; 0 keeps none
    pool_size: Count = 50  #: image pool of the discriminators; 0 has none
    width_discriminator: Positive = 64  #: first layer of the discriminators
    head_learning_rate: Amount = 0.0  #: of heads of DCLGAN and SimDCL; 0 for that of the others
    head_beta1: Share = 0.5  #: Adam's first, of those heads
    head_beta2: Share = 0.999  #: Adam's second, of those heads

    @property
    def epochs(self) -> int:
        """Epochs of the whole run."""
        return self.epochs_constant + self.epochs_decay

    def lr_factor(self, step: int, steps_per_epoch: int) -> float:
        """Factor on the learning rate at a step, counted from 0 over the whole run.

        ``linear`` is 1 for c epochs, then falls over d to zero: 1 − max(0, e+1−c)/(d+1); ``cosine``
        is half a cosine over all steps. Either is multiplied by a ramp over ``warmup_steps``.
        """
        ramp = min(1.0, (step + 1) / self.warmup_steps) if self.warmup_steps else 1.0
        if self.schedule == "linear":
            past = max(0, step // steps_per_epoch + 1 - self.epochs_constant)
            return ramp * (1.0 - past / (self.epochs_decay + 1))
        steps = self.epochs * steps_per_epoch
        return ramp * 0.5 * (1.0 + math.cos(math.pi * min(step, steps) / steps))


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """The configuration of one training run."""

    method: str = "proposed"  #: name of the method
    seed: Seed = 0  #: of weights, order and augmentation
    validate_every: Positive = 1  #: epochs from one validation to the next; the last has one
    save_every: Positive = 1  #: epochs from one checkpoint to the next; the end has one
    monitor: MetricName = "abs_rel"  #: metric of the held-out pairs whose best epoch is best.ckpt
    patience: Count = 0  #: epochs without a better one after which a run ends; 0 never ends it
    precision: Precision = "32-true"  #: by Fabric's name
    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    prompt: PromptConfig = field(default_factory=PromptConfig)
    output: OutputConfig = field(default_factory=OutputConfig)
    data: DataConfig = field(default_factory=DataConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optim: OptimConfig = field(default_factory=OptimConfig)


def updated(config: T, changes: object) -> T:
    """A copy with some fields replaced; nested mappings replace fields of nested dataclasses."""
    try:
        return merged(config, changes)
    except FieldError as refused:
        raise UsageError(str(refused)) from None


def check_config(config: TrainConfig) -> None:
    """Check values that depend on each other; the types of the fields check single values."""
    if config.output.min_m >= config.output.max_m:
        raise UsageError("output.min_m has to be below output.max_m")
    if config.optim.epochs < 1:
        raise UsageError("a run has at least one epoch: raise optim.epochs_decay")
    generator = config.generator
    for name, count in _LEVELS[generator.name].items():
        values = getattr(generator, name)
        if isinstance(values, str) or len(values) != count:
            raise UsageError(f"generator.{name} has to be {count} numbers")
    if generator.name == "encoder" and not isinstance(generator.encoder, str):
        raise UsageError("generator.encoder is the name of a model of timm: set it")
    _check_prompt(config)
    needs = [name for name in ("l1", *PAIRED_LOSSES) if getattr(config.loss, name)]
    needs += ["contrast=cfl"] if config.loss.contrast == "cfl" else []
    needs += [f"custom.{name}" for name in config.loss.custom]
    if needs and not config.data.paired:
        message = f"loss.{needs[0]} compares with the truth of the same scene"
        raise UsageError(message, "remove it or, if the method takes pairs, set data.paired=true")
    if config.data.channels > 1:
        _check_colour(config)


def _check_colour(config: TrainConfig) -> None:
    """Check that all networks that the losses need take images of three channels."""
    generator, loss = config.generator, config.loss
    names = {*TERMS}.difference(["l1"], PAIRED_LOSSES)
    others = (loss.l1 and loss.l1_backward) or any(getattr(loss, name) for name in names)
    if generator.name == "efficient" or (generator.name == "encoder" and others):
        message = "is for generator.name=resnet, or encoder with l1 and gradient alone"
        raise UsageError(f"data.colour=rgb {message}")
    if generator.residual == "input" and generator.name == "resnet":
        raise UsageError("generator.residual=input adds an image of one channel to the depth")


def _check_prompt(config: TrainConfig) -> None:
    generator = config.generator
    if bool(generator.prompt) != (config.method == "prompted"):
        raise UsageError("generator.prompt is for the method prompted, which needs it")
    if generator.prompt and (generator.name == "resnet" or config.output.coding != "log"):
        needs = "generator.name=efficient or encoder and output.coding=log"
        raise UsageError(f"the method prompted needs {needs}")
    if len(generator.prompt) not in (0, _PROMPT_LEVELS):
        raise UsageError(f"generator.prompt has to be {_PROMPT_LEVELS} numbers")
