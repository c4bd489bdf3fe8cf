"""Checks of configuration values that depend on each other; field types check single values."""

import math

from depthcli.errors import UsageError
from depthcli.training.config.objective import PAIRED_LOSSES
from depthcli.training.config.rules import LARGEST, LEAST_SIDE_PX
from depthcli.training.config.schema import GeneratorConfig, TrainConfig

_MOST_ROTATE_DEG = math.degrees(0.2)  # that a zoom of 1.2 has room for in a square picture
_STRIDE = 4  # of sizes; exported networks of any kind take multiples of it
_EFFICIENT_STRIDE = 32
_LEVELS = {"encoder": 5, "decoder": 4, "depths": 4}
_MAX_LEVELS = {"encoder": 4096, "decoder": 4096, "depths": 64}


def check_range(config: TrainConfig) -> None:
    """Check that a configuration can run.

    Raises:
        UsageError: a value is out of range; the message names the setting.
    """
    if not 1 / LARGEST <= config.output.min_m < config.output.max_m <= LARGEST:
        raise UsageError(
            "output.min_m is above 0 and below output.max_m, which is at most 1e9, "
            f"not {config.output.min_m} and {config.output.max_m}"
        )
    if config.optim.epochs < 1:
        raise UsageError("a run has at least one epoch: raise optim.epochs_decay")
    _check_views(config)
    _check_pairing(config)
    _check_generator(config)


def _check_views(config: TrainConfig) -> None:
    """Refuse augmentation that would have no effect, or views that are too small."""
    data = config.data
    if data.rotate_deg and data.zoom == 1:
        raise UsageError("data.rotate_deg needs room to turn: set data.zoom above 1")
    if data.rotate_deg > _MOST_ROTATE_DEG:
        most_deg = math.floor(10 * _MOST_ROTATE_DEG) / 10
        raise UsageError(
            f"data.rotate_deg is at most {most_deg}, or views would leave the picture; "
            f"not {data.rotate_deg}"
        )
    if data.turn and data.zoom == 1:
        raise UsageError("data.turn needs room to turn: set data.zoom above 1")
    if data.crop_286 and data.aspects:
        raise UsageError("data.crop_286 and data.aspects exclude each other: remove one of them")
    for aspect in data.aspects:
        width, height = data.view_sides(aspect)
        if min(width, height) < LEAST_SIDE_PX:
            raise UsageError(
                f"data.aspects={aspect:g} gives views of {width}×{height} pixels, and "
                f"{LEAST_SIDE_PX} is the least: raise data.width and data.height, or remove it"
            )
    if data.crop_286 and data.zoom > 1:
        raise UsageError("data.crop_286 and data.zoom exclude each other: remove one of them")
    if data.cutmix and config.optim.batch_size == 1:
        raise UsageError("data.cutmix takes a piece of another view: raise optim.batch_size to 2")


def _check_pairing(config: TrainConfig) -> None:
    """Refuse losses that need the ground truth of the same scene for unpaired data."""
    if config.data.paired:
        return
    needs = [name for name in ("l1", *PAIRED_LOSSES, "l1_backward") if getattr(config.loss, name)]
    needs += ["contrast=cfl"] if config.loss.contrast == "cfl" else []
    if needs:
        raise UsageError(
            f"loss.{needs[0]} compares with the truth of the same scene: "
            "remove it or, if the method learns from pairs, set data.paired=true"
        )


def check_sides(config: TrainConfig) -> None:
    """Check that an exported model can run at the size that it is trained and validated at.

    Raises:
        UsageError: a side is not a multiple of 4.
    """
    for name in ("width", "height"):
        value = getattr(config.data, name)
        if value % _STRIDE:
            raise UsageError(f"data.{name} must be a multiple of 4, not {value}")


def check_batch(config: TrainConfig, pictures: int) -> None:
    """Check the number of pictures per batch of one process.

    Raises:
        UsageError: batch norm would have a single value per channel.
    """
    data = config.data
    sizes = [(data.width, data.height), *map(data.view_sides, data.aspects)]
    smallest = any(max(size) <= _EFFICIENT_STRIDE for size in sizes)
    if config.generator.name == "efficient" and smallest and pictures == 1:
        raise UsageError(
            f"generator.name=efficient cannot learn from one picture of {_EFFICIENT_STRIDE} px "
            "at a time: raise data.width, data.height or optim.batch_size"
        )


def _check_generator(config: TrainConfig) -> None:
    if config.generator.name == "efficient":
        _check_levels(config.generator)
        check_batch(config, config.optim.batch_size)
    else:  # checkpoints of efficient networks of other sizes remain readable
        check_sides(config)


def _check_levels(generator: GeneratorConfig) -> None:
    for name, count in _LEVELS.items():
        values = getattr(generator, name)
        if len(values) != count or min(values) < 1:
            raise UsageError(f"generator.{name} is {count} numbers of at least 1, not {values}")
        if max(values) > _MAX_LEVELS[name]:
            raise UsageError(f"generator.{name} is at most {_MAX_LEVELS[name]}, not {values}")
