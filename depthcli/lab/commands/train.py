"""``depthcli train``: training methods on a folder of pairs."""

from __future__ import annotations

import itertools
import math
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from depthcli.cli import groups, options, shell
from depthcli.cli.screen import console
from depthcli.errors import SIGNAL_BASE, CheckpointError, ExitCode, TrainingError, UsageError
from depthcli.lab.commands.options import PatternOptions
from depthcli.lab.options import Tracker
from depthcli.lab.training.methods.table import METHODS, PRESETS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from depthcli.lab.training.config import TrainConfig

_PRESETS = ", ".join(
    f"{name} (for {method})" if method else name for name, method in PRESETS.items()
)


@groups.group
class RunOptions:
    """Several runs."""

    methods: list[str] | None = options.option(
        "Train these methods, each in the folder METHOD-seedK of --out; repeatable.",
        metavar="A,B",
        autocompletion=lambda: [*METHODS],
    )
    seeds: list[str] | None = options.option(
        "Train each method with each of these seeds, in METHOD-seedK; repeatable.", metavar="K,L"
    )
    grid: list[str] | None = options.option(
        "Train with each of these values of a setting, such as loss.l1=1,10, in "
        "METHOD-loss.l1=1-seedK; repeatable, for all combinations.",
        metavar="NAME=A,B",
    )

    def settings(self) -> Iterator[tuple[str, ...]]:
        """The settings of each point of the grid; one without any if there is none."""
        named = [axis.partition("=") for axis in self.grid or ()]
        axes = ([f"{name}={value}" for value in values.split(",")] for name, _, values in named)
        return itertools.product(*axes)


@groups.group
class DataOptions:
    """Data and initial weights."""

    data: Path | None = options.usual(
        "NYU Depth v2 (.mat file or folder; nyu for that of $DEPTHCLI_NYU), or a folder with rgb/ "
        "and depth/, or in the layout of TUM RGB-D, ScanNet, 7-Scenes, 3DMatch, KITTI, Ultralytics."
    )
    names: PatternOptions
    pseudo_labels: Path | None = options.option(
        "Further pairs, rgb/ and depth/ in millimetres, of less reliable depth: predictions.",
        metavar="DIR",
    )
    init: list[Path] | None = options.option(
        "Start from a model (name, .onnx file or folder) or checkpoint, repeatable: from their "
        "mean. A .pth file is a pretrained encoder; 'hub' downloads that of timm.",
        metavar="MODEL|CKPT",
    )


@groups.group
class ConfigOptions:
    """Configuration."""

    preset: str | None = options.usual(
        f"Configuration preset: {_PRESETS}.",
        metavar="NAME",
        autocompletion=lambda: [*PRESETS],
    )
    config: list[Path] | None = options.option(
        "TOML file that overrides the configuration; repeatable.", metavar="FILE"
    )
    settings: list[str] | None = options.usual(
        "Override a setting of --show-config, such as optim.batch_size=8; repeatable.",
        "--set",
        metavar="NAME=VALUE",
    )
    show_config: bool = options.usual("Print the full configuration and exit.", default=False)


@groups.group
class DeviceOptions:
    """Time and device."""

    max_minutes: float | None = options.usual(
        "Time limit in minutes, for all runs together; they can be resumed.",
        min=0.0,
        callback=options.not_negative,
    )
    accelerator: str = options.option(
        "auto, cpu, cuda or mps.",
        default="auto",
        metavar="NAME",
        autocompletion=lambda: ["auto", "cpu", "cuda", "mps"],
    )
    threads: int | None = options.option(
        "CPU threads. Default: those of the run that is resumed, or one per core.",
        min=1,
        max=options.MAX_THREADS,
    )


@groups.group
class FollowOptions:
    """Loggers and callbacks."""

    log: list[Tracker] | None = options.option(
        "Also log losses, scores and sample images to this tool; repeatable."
    )
    callback: list[str] | None = options.option(
        "What makes a callback of your own from folder and configuration of a run; repeatable.",
        metavar="MODULE:NAME",
    )


def train(
    method: str | None = typer.Argument(
        None,
        metavar="[METHOD]",
        autocompletion=lambda: [*METHODS],
        help=f"One of {', '.join(METHODS)}, or your own as MODULE:CLASS.",
    ),
    *,
    out: Path = typer.Option(
        Path("runs/train"),
        "-o",
        "--out",
        metavar="DIR",
        help="Output folder for checkpoint, log and samples; resumes if it has a checkpoint.",
    ),
    data: DataOptions,
    runs: RunOptions,
    config: ConfigOptions,
    device: DeviceOptions,
    follow: FollowOptions,
    screen: options.ScreenOptions,
) -> int:
    """Train one or more methods. Run the same command again to resume."""
    from depthcli.lab.commands.screen import show_config
    from depthcli.lab.training.settings import resolve_config

    methods, seeds = listed(runs.methods) or (method or "",), listed(runs.seeds)
    if not methods[0] or (method and runs.methods):
        raise UsageError("", "name a METHOD, or several with {methods}")
    planned: dict[Path, Callable[..., TrainConfig]] = {}
    is_one, init = not (runs.methods or seeds or runs.grid), data.init[0] if data.init else None
    for name, point, seed in itertools.product(methods, runs.settings(), seeds or (None,)):
        settings = [*(config.settings or ()), *point, *([f"seed={seed}"] if seed else [])]
        files = config.config or ()
        resolve = partial(resolve_config, name, config.preset, files, settings, init=init)
        if config.show_config:
            show_config(resolve())
        run = "-".join((name.replace(":", "."), *point, f"seed{resolve().seed}"))
        planned[out if is_one else out / run] = resolve
    if config.show_config:
        return ExitCode.OK
    return _train_runs(planned, data, device, follow, screen)


def listed(words: list[str] | None) -> tuple[str, ...]:
    """Items of comma-separated lists, without duplicates."""
    items = (word.strip() for word in ",".join(words or ()).split(","))
    return tuple(dict.fromkeys(filter(None, items)))


def _train_runs(
    planned: Mapping[Path, Callable[..., TrainConfig]],
    data: DataOptions,
    device: DeviceOptions,
    follow: FollowOptions,
    screen: options.ScreenOptions,
) -> int:
    """Train the runs one after another; those to come share the time that is left."""
    from depthcli.lab.commands.screen import callback_for, print_result
    from depthcli.lab.jobs.train import TrainRequest, train

    minutes = math.inf if device.max_minutes is None else device.max_minutes
    code, end_s = ExitCode.OK, time.monotonic() + 60 * minutes
    for index, (folder, resolve) in enumerate(planned.items()):
        run = folder.name if len(planned) > 1 else None
        try:
            config = resolve(folder=folder)
            if data.data is None:
                raise UsageError("", "give the data set with {data}")
            request = TrainRequest(
                config=config,
                data=data.data,
                patterns=data.names.patterns,
                out=folder,
                pseudo_labels=data.pseudo_labels,
                init_weights=tuple(data.init or ()),
                minutes=(end_s - time.monotonic()) / 60 / (len(planned) - index),
                accelerator=device.accelerator,
                threads=device.threads,
                trackers=tuple(dict.fromkeys(follow.log or ())),
                callbacks=tuple(follow.callback or ()),
                signals=shell.ending_signals(),
            )
            with callback_for(screen, run) as callback:
                result = train(request, callback)
        except (CheckpointError, TrainingError) as error:
            if len(planned) == 1:
                raise
            console.error(error.message.about(folder.name))
            code = ExitCode.SOME_FAILED
            continue
        if screen.shows_text:
            print_result(result, folder)
        if result.signal_number is not None:
            return SIGNAL_BASE + result.signal_number
    return code
