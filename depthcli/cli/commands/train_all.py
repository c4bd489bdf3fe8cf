"""``depthcli train --all``: several methods and seeds, one after another."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.cli.signals import SIGNAL_BASE, ending_signals
from depthcli.errors import ExitCode, UsageError

if TYPE_CHECKING:
    import typer

    from depthcli.jobs.train.queue import QueueRequest

_OF_THE_QUEUE = {
    *("method", "every_method", "methods", "seeds", "data", "out", "preset", "config", "settings"),
    *("show_config", "max_minutes", "as_json"),
}
"""Options that are not handed on as they are."""


def train_all(context: typer.Context) -> int:
    """Train what the options of ``depthcli train`` name; run again to continue."""
    options = context.params
    if options["method"]:
        raise UsageError("give a METHOD, or --all or --methods, not both")
    if options["show_config"]:
        raise UsageError("--show-config shows one method: name it in place of --all or --methods")
    if options["data"] is None:
        raise UsageError("give the data set with --data")
    from depthcli.cli.screen.training_queue import QueueScreen
    from depthcli.jobs.train.queue import Queue

    queue = Queue(_request(context))
    screen = QueueScreen(as_json=options["as_json"], quiet=options["quiet"])
    for event in queue:
        screen.print_event(event)
    screen.print_summary(queue.sittings)
    if queue.signal_number is not None:
        return SIGNAL_BASE + queue.signal_number
    failed = any(sitting.state == "failed" for sitting in queue.sittings)
    return ExitCode.SOME_FAILED if failed else ExitCode.OK


def _request(context: typer.Context) -> QueueRequest:
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
        options=tuple(_handed_on(context)),
        tells_epochs=options["as_json"],
        signals=ending_signals(),
    )


def _split_list(text: str) -> tuple[str, ...]:
    """Words between commas, each once."""
    words = tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    if not words:
        raise UsageError("--methods and --seeds take a list, such as cut,proposed or 0,1")
    return words


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise UsageError(f"--seeds takes integers such as 0,1, not '{text}'")
    return int(text)


def _handed_on(context: typer.Context) -> list[str]:
    """The words for the options that each run gets as they were given."""
    words: list[str] = []
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if parameter.name in _OF_THE_QUEUE or value in (None, False):
            continue
        flag = max(parameter.opts, key=len)
        given = value if isinstance(value, list | tuple) else [value]
        words += [flag] if value is True else [word for one in given for word in (flag, str(one))]
    return words
