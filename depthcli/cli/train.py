"""``depthcli train``: a method on a folder of pairs."""

from __future__ import annotations

import math
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from depthcli.cli import console
from depthcli.errors import DepthcliError, ExitCode, UsageError

if TYPE_CHECKING:
    from lightning_fabric import Fabric

    from depthcli.training.config import TrainConfig

_SIGNAL_BASE = 128  # shells report a signal as 128 + its number

app = typer.Typer(rich_markup_mode=None, add_completion=False)

_Method = Annotated[
    str, typer.Argument(help="cyclegan, cut, fastcut, dclgan, simdcl, hnegsrc or proposed.")
]
_Data = Annotated[
    Path | None,
    typer.Option(help="NYU Depth v2: the .mat file, or a folder of rgb/, depth/, index.csv."),
]
_Out = Annotated[
    Path, typer.Option(help="Folder for checkpoint, log and samples; continued if it has one.")
]
_Preset = Annotated[str | None, typer.Option(help="Named settings that ship with depthcli.")]
_Config = Annotated[list[Path] | None, typer.Option(help="TOML file of differences; repeatable.")]
_Set = Annotated[
    list[str] | None, typer.Option("--set", help="One setting, a.b=value; repeatable.")
]
_Show = Annotated[bool, typer.Option("--show-config", help="Print the whole configuration, stop.")]
_Minutes = Annotated[
    float | None,
    typer.Option(min=0.0, help="Stop cleanly after so many minutes, to continue later."),
]
_Accelerator = Annotated[str, typer.Option(help="auto, cpu, cuda or mps.")]
_Threads = Annotated[int | None, typer.Option(min=1, help="CPU threads; default: all cores.")]
_Json = Annotated[bool, typer.Option("--json", help="One JSON object per epoch.")]
_Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]


@app.command()
def train(
    method: _Method,
    data: _Data = None,
    out: _Out = Path("runs/train"),
    preset: _Preset = None,
    config: _Config = None,
    settings: _Set = None,
    show_config: _Show = False,
    max_minutes: _Minutes = None,
    accelerator: _Accelerator = "auto",
    threads: _Threads = None,
    as_json: _Json = False,
    quiet: _Quiet = False,
) -> int:
    """Train a method; run the same command again to continue where it stopped."""
    resolved = _resolve(method, preset, config or [], settings or [])
    if show_config:
        _print_config(resolved)
        return ExitCode.OK
    if data is None:
        raise typer.BadParameter("give the data set with --data")
    from depthcli.cli.train_progress import progress_for
    from depthcli.datasets.nyu import open_nyu
    from depthcli.training.interrupt import Interrupt
    from depthcli.training.loop import Limits
    from depthcli.training.loop import train as run

    if threads:
        import torch

        torch.set_num_threads(threads)
    fabric = _fabric(accelerator, resolved.precision)
    interrupt = Interrupt(signal.SIGINT, signal.SIGTERM)
    with progress_for(as_json=as_json, quiet=quiet) as watcher:
        limits = Limits(minutes=math.inf if max_minutes is None else max_minutes)
        done = run(resolved, open_nyu(data), out, fabric, watcher, limits, interrupt)
    if not quiet and not as_json:
        console.note(f"{done.step} steps in {done.seconds / 60:.1f} min; checkpoint in {out}")
    return ExitCode.OK if interrupt.number is None else _SIGNAL_BASE + interrupt.number


def _fabric(accelerator: str, precision: Literal["32-true", "bf16-mixed", "16-mixed"]) -> Fabric:
    import logging

    from lightning_fabric import Fabric

    logging.getLogger("lightning_fabric").setLevel(logging.ERROR)  # it would speak under --quiet
    try:
        return Fabric(accelerator=accelerator, devices=1, precision=precision)
    except (ImportError, RuntimeError, ValueError) as error:
        raise UsageError(
            f"cannot train with --accelerator {accelerator} and precision={precision} here: {error}"
        ) from error


def _resolve(
    method: str, preset: str | None, files: list[Path], settings: list[str]
) -> TrainConfig:
    try:
        from depthcli.training.config import resolve
        from depthcli.training.methods.registry import METHODS, check_terms, default_config
        from depthcli.training.preset_files import preset_file
    except ImportError as error:
        raise DepthcliError(
            f"training needs {error.name}: pip install 'depthcli[train]'"
        ) from error
    if method not in METHODS:
        raise typer.BadParameter(f"no method '{method}'; choose from {', '.join(METHODS)}")
    named = [preset_file(preset)] if preset else []
    resolved = resolve(default_config(method), [*named, *files], settings)
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
