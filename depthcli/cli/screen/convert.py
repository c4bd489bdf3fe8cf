"""What a conversion cost, as text and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.core.text import one_line

if TYPE_CHECKING:
    from depthcli.jobs.convert import Converted

_NOT_READ_BACK = {"max_error": None, "mean_error": None, "lost": None}


def print_conversion_json(done: Converted) -> None:
    """The object of ``--json``."""
    console.out_json(
        {
            "input": done.source,
            "output": done.target,
            "unit": "m" if done.depth.is_metric else None,
            **(asdict(done.round_trip) if done.round_trip else _NOT_READ_BACK),
            "warnings": list(done.warnings),
        }
    )


def print_conversion(done: Converted) -> None:
    """One line, and the warnings."""
    line = f"{done.source} -> {done.target}"
    if done.round_trip is not None:
        unit = " m" if done.depth.is_metric else ""
        line += (
            f"  round trip: max error {done.round_trip.max_error:.3g}{unit}, "
            f"mean {done.round_trip.mean_error:.3g}{unit}, {done.round_trip.lost} pixels lost"
        )
    console.say(one_line(line))
    for warning in done.warnings:
        console.warn(warning)
