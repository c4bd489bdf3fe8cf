"""The configuration of a training run, as a tree of frozen dataclasses; saved in checkpoints.

:mod:`~depthcli.training.config.overrides` applies files and settings to a method's defaults.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

from depthcli.core.codec import DepthCodec
from depthcli.io.formats.table import MILLIMETRES
from depthcli.training.config.objective import LossConfig, OptimConfig
from depthcli.training.config.rules import (
    Amount,
    Aspect,
    Blocks,
    Count,
    Positive,
    PositiveFloat,
    Seed,
    Share,
    Side,
    UnitInterval,
    Width,
    Zoom,
)

_SIDE_STEP_PX = 16  # of views of other aspect ratios


@dataclass(frozen=True, slots=True)
class GeneratorConfig:
    """The generator G and, where a method has one, the backward generator F."""

    #: ``resnet`` is the paper's, ``efficient`` the one that ships
    name: Literal["resnet", "efficient"] = "resnet"
    width: Width = 64  #: channels of the first layer of ``resnet``
    blocks: Blocks = 9  #: residual blocks of ``resnet``
    #: final residual connection of ``resnet``: stem features, input, or none
    residual: Literal["none", "stem", "input"] = "stem"
    antialias: bool = False  #: blur when ``resnet`` changes resolution (the CUT family)
    #: channels of ``efficient`` at strides 2, 4, 8, 16, 32
    encoder: tuple[int, ...] = (32, 64, 128, 192, 256)
    #: channels of ``efficient`` at strides 16, 8, 4, 2
    decoder: tuple[int, ...] = (128, 96, 64, 48)
    #: residual blocks of ``efficient`` at strides 4, 8, 16, 32
    depths: tuple[int, ...] = (2, 2, 2, 2)
    dropout: Share = 0.0  #: share of bottleneck channels of ``efficient`` dropped while training
    #: of ``efficient``: ``batch``, or ``none`` to start from an exported model, where it is folded.
    #: Statistics of ``batch`` are those of all inputs of G: with identity, cycle or contrast also
    #: of depth maps
    norm: Literal["batch", "none"] = "batch"


@dataclass(frozen=True, slots=True)
class OutputConfig:
    """How depth is encoded for the networks."""

    #: ``linear`` maps [0, max_m] to [-1, 1] (the paper), ``log`` maps [min_m, max_m]
    coding: Literal["linear", "log"] = "linear"
    #: nearest depth of the log coding, metres; also the clip of the exported model
    min_m: float = 0.4
    max_m: float = 10.0  #: farthest depth, metres

    @property
    def codec(self) -> DepthCodec:
        """The mapping between raw outputs and metres."""
        if self.coding == "linear":
            return DepthCodec.linear_m(self.max_m)
        return DepthCodec.log_m(self.min_m, self.max_m)


@dataclass(frozen=True, slots=True)
class DataConfig:
    """Network inputs, augmentation and splits."""

    width: Side = 256  #: network input width, px
    height: Side = 256  #: network input height, px
    #: ``value`` is V of HSV (the paper), ``luma`` Rec. 601
    colour: Literal["value", "luma"] = "value"
    #: aligned pairs of picture and depth map; False samples them independently
    paired: bool = True
    #: enlarge pictures by 286/256, then crop, as the original methods do; depth is not divided by
    #: this zoom, so its metres are not true
    crop_286: bool = False
    zoom: Zoom = 1.0  #: largest zoom-in; depth is divided by the zoom, so metres stay true
    #: further aspect ratios (width / height) of views; half of the batches have one of them
    aspects: tuple[Aspect, ...] = ()
    #: fraction of the views that are taken with a rotated camera; the others are crops
    turn: UnitInterval = 0.0
    rotate_deg: Amount = 0.0  #: largest rotation about the optical axis, degrees
    colour_jitter: Amount = 0.0  #: standard deviation of the log gain of each colour channel
    gamma: Amount = 0.0  #: standard deviation of the log gamma of V
    brightness: Amount = 0.0  #: standard deviation of the log gain of V
    blur: UnitInterval = 0.0  #: largest weight of a binomial filter, in [0, 1]
    #: fraction of the views without the border of their picture: in half of them it repeats the
    #: pixels inside it, in the other half it is painted in one gray
    border: UnitInterval = 0.0
    noise: Amount = 0.0  #: largest standard deviation of pixel noise, in [0, 1] units
    pseudo_label_share: Share = (
        0.5  #: fraction of each batch from the pseudo labels, if there are any
    )
    #: probability that a view gets a rectangle of another one, picture and depth alike
    cutmix: Share = 0.0
    #: NYU Depth v2: the split whose training pairs are used
    split: Literal["paper", "official"] = "paper"
    #: depth units per metre in a custom folder
    units_per_metre: PositiveFloat = MILLIMETRES
    #: every n-th scene by name is held out for validation; 0 holds out none
    holdout_every: Count = 7
    holdout_offset: Count = 3  #: index of the first of them

    def view_sides(self, aspect: float) -> tuple[int, int]:
        """Width and height of views of another aspect ratio, px, with about as many pixels."""
        width = math.sqrt(self.width * self.height * aspect)
        across, down = (
            max(1, round(side / _SIDE_STEP_PX)) * _SIDE_STEP_PX for side in (width, width / aspect)
        )
        return across, down


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """The configuration of one training run."""

    method: str = "proposed"  #: name of the method
    seed: Seed = 0  #: of weights, order and augmentation
    #: epochs from one validation to the next; the last is always validated
    validate_every: Positive = 1
    #: epochs from one checkpoint to the next; a run that stops always writes one
    save_every: Positive = 1
    #: Fabric's name of it: ``32-true``, ``bf16-mixed`` or ``16-mixed``
    precision: Literal["32-true", "bf16-mixed", "16-mixed"] = "32-true"
    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    output: OutputConfig = field(default_factory=OutputConfig)
    data: DataConfig = field(default_factory=DataConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optim: OptimConfig = field(default_factory=OptimConfig)
