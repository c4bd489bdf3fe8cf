"""``depthcli train``: a method on a folder of pairs."""

from __future__ import annotations

import math
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.arguments import completion
from depthcli.cli.screen import console
from depthcli.cli.signals import SIGNAL_BASE, ending_signals
from depthcli.core.extras import INSTALL_TRAIN
from depthcli.errors import DepthcliError, ExitCode, UsageError

if TYPE_CHECKING:
    from depthcli.training.config.schema import TrainConfig

app = typer.Typer(rich_markup_mode=None, add_completion=False)

_Method = Annotated[
    str | None,
    typer.Argument(
        metavar="[METHOD]",
        autocompletion=completion.methods,
        help="cyclegan, cut, fastcut, dclgan, simdcl, hnegsrc or proposed.",
    ),
]
_All = Annotated[
    bool, typer.Option("--all", help="Train every method, each in a folder METHOD-seedK of --out.")
]
_Methods = Annotated[
    str | None,
    typer.Option(
        metavar="A,B",
        autocompletion=completion.method_lists,
        help="Train these methods, as --all does (for example cut,proposed).",
    ),
]
_Seeds = Annotated[
    str | None,
    typer.Option(
        metavar="K,L", help="With --all or --methods: one run per seed (for example 0,1)."
    ),
]
_Data = Annotated[
    Path | None,
    typer.Option(
        help="NYU Depth v2 as .mat file or as folder with rgb/, depth/, index.csv; or a custom "
        "folder with rgb/ and depth/."
    ),
]
_Out = Annotated[
    Path,
    typer.Option(
        help="Output folder for checkpoint, log and samples; resumes if it has a checkpoint."
    ),
]
_Preset = Annotated[
    str | None,
    typer.Option(autocompletion=completion.presets, help="Configuration preset."),
]
_Config = Annotated[
    list[Path] | None, typer.Option(help="TOML file that overrides the configuration; repeatable.")
]
_Set = Annotated[
    list[str] | None, typer.Option("--set", help="Override one setting, as a.b=value; repeatable.")
]
_Show = Annotated[
    bool, typer.Option("--show-config", help="Print the full configuration and exit.")
]
_Minutes = Annotated[
    float | None,
    typer.Option(min=0.0, help="Time limit in minutes; the run can be resumed."),
]
_Accelerator = Annotated[
    str, typer.Option(autocompletion=completion.accelerators, help="auto, cpu, cuda or mps.")
]
_Extra = Annotated[
    Path | None,
    typer.Option(
        help="Further pairs whose metres are less sure, rgb/ and depth/ in millimetres: "
        "predictions of another model, say."
    ),
]
_Init = Annotated[
    Path | None,
    typer.Option(help="Start from the weights of an exported model (.onnx) or a checkpoint."),
]
_Devices = Annotated[
    int, typer.Option(min=1, help="Number of GPUs (or CPU processes) for data-parallel training.")
]
_Threads = Annotated[
    int | None,
    typer.Option(min=1, help="CPU threads. Default: the fastest in a short trial."),
]
_TensorBoard = Annotated[
    bool,
    typer.Option("--tensorboard", help="Also write TensorBoard event files to OUT/tensorboard."),
]
_Json = Annotated[bool, typer.Option("--json", help="Print one JSON object per epoch.")]
_Quiet = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]


@app.command()
def train(
    context: typer.Context,
    method: _Method = None,
    every_method: _All = False,
    methods: _Methods = None,
    seeds: _Seeds = None,
    data: _Data = None,
    out: _Out = Path("runs/train"),
    extra: _Extra = None,
    init: _Init = None,
    preset: _Preset = None,
    config: _Config = None,
    settings: _Set = None,
    show_config: _Show = False,
    max_minutes: _Minutes = None,
    accelerator: _Accelerator = "auto",
    devices: _Devices = 1,
    threads: _Threads = None,
    tensorboard: _TensorBoard = False,
    as_json: _Json = False,
    quiet: _Quiet = False,
) -> int:
    """Train a method. Run the same command again to resume."""
    if every_method or methods is not None:
        from depthcli.jobs.train.queue import train_all

        return train_all(context)
    if method is None or seeds is not None:
        raise typer.BadParameter("name a METHOD; --seeds goes with --all or --methods")
    folder = None if show_config else out
    resolved = resolve_config(method, preset, config or [], settings or [], folder)
    if show_config:
        _print_config(resolved)
        return ExitCode.OK
    if data is None:
        raise typer.BadParameter("give the data set with --data")
    from depthcli.cli.screen.training import progress_for, with_board
    from depthcli.datasets.paired_folder import open_paired_folder
    from depthcli.datasets.training_data import open_training_data
    from depthcli.jobs.train.launch import launched, open_fabric, set_threads
    from depthcli.training.interrupt import Interrupt
    from depthcli.training.loop import Limits, divide
    from depthcli.training.loop import train as run

    fabric = open_fabric(accelerator, resolved.precision, devices)
    opened = open_training_data(
        data,
        paired=resolved.data.paired,
        split=resolved.data.split,
        units_per_metre=resolved.data.units_per_metre,
    )
    opened = opened._replace(extra=None if extra is None else open_paired_folder(extra))
    with launched(fabric):
        first = fabric.is_global_zero
        set_threads(threads, resolved, out, fabric, quiet=quiet or as_json or not first)
        if first and not quiet and resolved.data.holdout_every:
            _, held_out = divide(opened.dataset, resolved.data)
            if not held_out:
                console.warn("too few scenes to hold one out, so nothing is validated")
        interrupt = Interrupt(signal.SIGINT, *ending_signals())
        with ExitStack() as stack:
            watcher = stack.enter_context(progress_for(as_json=as_json, quiet=quiet or not first))
            if tensorboard and first:
                watcher = stack.enter_context(with_board(watcher, out, resolved))
            limits = Limits(minutes=math.inf if max_minutes is None else max_minutes)
            done = run(resolved, opened, out, fabric, watcher, limits, interrupt, init)
    if not first:
        return ExitCode.OK
    if not quiet and not as_json:
        console.note(f"{done.step} steps in {done.seconds / 60:.1f} min; checkpoint in {out}")
    return ExitCode.OK if interrupt.number is None else SIGNAL_BASE + interrupt.number


def resolve_config(
    method: str,
    preset: str | None,
    files: list[Path],
    settings: list[str],
    folder: Path | None = None,
) -> TrainConfig:
    """The configuration that a command line stands for.

    Args:
        method: that was named.
        preset: name of a preset.
        files: of differences.
        settings: ``a.b=c``.
        folder: of a run, whose own configuration counts if there is one.

    Raises:
        UsageError: a name or a value is wrong.
        CheckpointError: the folder's run has not what was given.
    """
    try:
        from depthcli.training.config.changes import resolve
        from depthcli.training.continued import continued, saved_run
        from depthcli.training.methods.registry import METHODS, check_terms, default_config
        from depthcli.training.preset_files import preset_file
    except ImportError as error:
        raise DepthcliError(f"training needs {error.name}: {INSTALL_TRAIN}") from error
    if method not in METHODS:
        raise typer.BadParameter(f"no method '{method}'; choose from {', '.join(METHODS)}")
    named = [preset_file(preset)] if preset else []
    saved = None if folder is None else saved_run(folder)
    if folder is not None and saved is not None:
        return continued(folder, saved.config, method, [*named, *files], settings)
    resolved = resolve(default_config(method), [*named, *files], settings)
    if resolved.method != method:
        raise UsageError(
            f"the settings are of method {resolved.method}, not {method}: name that one, or leave "
            "their method out"
        )
    check_terms(resolved)
    return resolved


def _print_config(config: TrainConfig) -> None:
    import dataclasses
    import json

    for name, value in dataclasses.asdict(config).items():
        if not isinstance(value, dict):
            console.out(f"{name} = {json.dumps(value)}")
    for name, group in dataclasses.asdict(config).items():
        if isinstance(group, dict):
            console.out(f"\n[{name}]")
            for key, value in group.items():
                console.out(f"{key} = {json.dumps(value)}")
