"""``depthcli train``: training a method on a folder of pairs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli import completion, options
from depthcli.cli.options import not_negative
from depthcli.cli.process import ending_signals
from depthcli.errors import SIGNAL_BASE, ExitCode, UsageError
from depthcli.training.methods.table import METHODS
from depthcli.training.settings import preset_names

if TYPE_CHECKING:
    from depthcli.jobs.train_queue import QueueRequest


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
    from depthcli.jobs import train as run

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


_QUEUE_OPTIONS = {
    *("method", "every_method", "methods", "seeds", "data", "out", "preset", "config", "settings"),
    *("pseudo_labels", "init", "show_config", "max_minutes", "as_json"),
}
"""Options that are not forwarded to the runs unchanged."""


def train_all(context: typer.Context) -> int:
    """Train several runs, or resume them."""
    options = context.params
    if options["method"]:
        raise UsageError("give a METHOD, or --all or --methods, not both")
    if options["show_config"]:
        raise UsageError("--show-config shows one method: name it in place of --all or --methods")
    if options["data"] is None:
        raise UsageError("give the data set with --data")
    from depthcli.cli.screen.training import QueueScreen
    from depthcli.jobs.train_queue import TrainingQueue

    queue = TrainingQueue(_queue_request(context))
    screen = QueueScreen(as_json=options["as_json"], quiet=options["quiet"])
    for event in queue:
        screen.print_event(event)
    screen.print_summary(queue.statuses)
    if queue.signal_number is not None:
        return SIGNAL_BASE + queue.signal_number
    failed = any(status.state == "failed" for status in queue.statuses)
    return ExitCode.SOME_FAILED if failed else ExitCode.OK


def _queue_request(context: typer.Context) -> QueueRequest:
    from depthcli.jobs.train_queue import QueueRequest

    options = context.params
    minutes, seeds = options["max_minutes"], options["seeds"]
    return QueueRequest(
        data=Path(options["data"]),
        out=Path(options["out"]),
        methods=() if options["methods"] is None else _split_list(options["methods"]),
        seeds=() if seeds is None else tuple(_seed(text) for text in _split_list(seeds)),
        preset=options["preset"],
        files=tuple(Path(file) for file in options["config"] or ()),
        settings=tuple(options["settings"] or ()),
        minutes=math.inf if minutes is None else minutes,
        pseudo_labels=Path(options["pseudo_labels"]) if options["pseudo_labels"] else None,
        init_weights=tuple(map(Path, options["init"] or ())),
        options=tuple(_forwarded_options(context)),
        report_epochs=options["as_json"],
        signals=ending_signals(),
    )


def _split_list(text: str) -> tuple[str, ...]:
    """Items of a comma-separated list, without duplicates."""
    words = tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    if not words:
        raise UsageError("--methods and --seeds take a list, such as cut,proposed or 0,1")
    return words


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise UsageError(f"--seeds takes integers such as 0,1, not '{text}'")
    return int(text)


def _forwarded_options(context: typer.Context) -> list[str]:
    """The command-line arguments of the options that are forwarded to each run."""
    words: list[str] = []
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if parameter.name in _QUEUE_OPTIONS or value in (None, False):
            continue
        flag = max(parameter.opts, key=len)
        given = value if isinstance(value, list | tuple) else [value]
        words += [flag] if value is True else [word for one in given for word in (flag, str(one))]
    return words
