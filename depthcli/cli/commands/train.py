"""``depthcli train``: training a method on a folder of pairs."""

import math
from pathlib import Path
from typing import Annotated

import typer

from depthcli.cli.arguments import completion, options
from depthcli.cli.arguments.numbers import not_negative
from depthcli.cli.signals import ending_signals
from depthcli.errors import SIGNAL_BASE, ExitCode, UsageError
from depthcli.training.config.presets import preset_names
from depthcli.training.methods.table import METHODS

app = typer.Typer(rich_markup_mode=None)


@app.command()
def train(
    context: typer.Context,
    method: Annotated[
        str | None,
        typer.Argument(
            metavar="[METHOD]",
            autocompletion=completion.methods,
            help=f"One of {', '.join(METHODS)}; or masked, which learns from pictures without "
            "depth, for --init.",
        ),
    ] = None,
    every_method: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Train every method but masked, each in a folder METHOD-seedK of --out.",
        ),
    ] = False,
    methods: Annotated[
        str | None,
        typer.Option(
            metavar="A,B",
            autocompletion=completion.method_lists,
            help="Train these methods, as --all does (for example cut,proposed).",
        ),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            metavar="K,L", help="With --all or --methods: one run per seed (for example 0,1)."
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            help="NYU Depth v2 as .mat file or as folder with rgb/, depth/, index.csv; or a custom "
            "folder with rgb/ and depth/; for masked, any folder of pictures."
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Output folder for checkpoint, log and samples; resumes if it has a checkpoint.",
        ),
    ] = Path("runs/train"),
    pseudo_labels: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Additional pairs with less reliable depth, such as predictions of another model: "
            "rgb/ and depth/ in millimetres.",
        ),
    ] = None,
    init: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="MODEL|CKPT",
            help="Start from the weights of a model (name, .onnx file or folder) or a checkpoint. "
            "Repeatable: from the mean of their weights.",
        ),
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            autocompletion=completion.presets,
            help=f"Configuration preset: {', '.join(preset_names())}.",
        ),
    ] = None,
    config: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE", help="TOML file that overrides the configuration; repeatable."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Override one setting ('--show-config' lists them), such as optim.batch_size=8; "
            "repeatable.",
        ),
    ] = None,
    show_config: Annotated[
        bool, typer.Option("--show-config", help="Print the full configuration and exit.")
    ] = False,
    max_minutes: Annotated[
        float | None,
        typer.Option(
            min=0.0, callback=not_negative, help="Time limit in minutes; the run can be resumed."
        ),
    ] = None,
    accelerator: Annotated[
        str,
        typer.Option(
            metavar="NAME", autocompletion=completion.accelerators, help="auto, cpu, cuda or mps."
        ),
    ] = "auto",
    devices: Annotated[
        int,
        typer.Option(
            min=1, max=1024, help="Number of GPUs (or CPU processes) for data-parallel training."
        ),
    ] = 1,
    threads: Annotated[
        int | None,
        typer.Option(min=1, max=1024, help="CPU threads. Default: the fastest in a short trial."),
    ] = None,
    tensorboard: Annotated[
        bool,
        typer.Option(
            "--tensorboard", help="Also write TensorBoard event files to OUT/tensorboard."
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object per epoch.")
    ] = False,
    quiet: options.QuietOption = False,
) -> int:
    """Train a method. Run the same command again to resume."""
    if every_method or methods is not None:
        from depthcli.cli.commands.train_all import train_all

        return train_all(context)
    if method is None:
        raise UsageError("name a METHOD, or give --all or --methods")
    if seeds is not None:
        raise UsageError("--seeds goes with --all or --methods")
    from depthcli.cli.screen import training as screen
    from depthcli.training.resolve import resolve_config

    folder = None if show_config else out
    resolved = resolve_config(method, preset, config or (), settings or (), folder)
    if show_config:
        screen.show_config(resolved)
        return ExitCode.OK
    if data is None:
        raise UsageError("give the data set with --data")
    from depthcli.jobs.train import run

    request = run.TrainRequest(
        config=resolved,
        data=data,
        out=out,
        pseudo_labels=pseudo_labels,
        init_weights=tuple(init or ()),
        minutes=math.inf if max_minutes is None else max_minutes,
        accelerator=accelerator,
        devices=devices,
        threads=threads,
        tensorboard=tensorboard,
        signals=ending_signals(),
    )
    with screen.callback_for(as_json=as_json, quiet=quiet) as callback:
        result = run.train(request, callback)
    if not result.is_global_zero:
        return ExitCode.OK
    if not quiet and not as_json:
        screen.print_result(result, out)
    number = result.signal_number
    return ExitCode.OK if number is None else SIGNAL_BASE + number
