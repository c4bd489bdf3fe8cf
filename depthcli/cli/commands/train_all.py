"""``depthcli train --all``: training several methods and seeds, one after another."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.cli.signals import ending_signals
from depthcli.errors import SIGNAL_BASE, ExitCode, UsageError

if TYPE_CHECKING:
    import typer

    from depthcli.jobs.train.queue import QueueRequest

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
    from depthcli.cli.screen.training_queue import QueueScreen
    from depthcli.jobs.train.queue import TrainingQueue

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
    from depthcli.jobs.train.queue import QueueRequest

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
