"""How an evaluation looks: its progress, its table, its JSON and its CSV file."""

from __future__ import annotations

import math
from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.cli.screen.progress import drawn
from depthcli.io.storage.atomic import atomic_path
from depthcli.metrics.boundary import HIGHER_IS_BETTER
from depthcli.metrics.depth import METRICS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from depthcli.evaluation.nyu import Stage
    from depthcli.evaluation.report import Report, ReportRow

_DECIMALS = {"silog": 2, "dbe_acc": 2, "dbe_comp": 2}
_TEXT_COLUMNS = 2


@contextmanager
def stages(*, quiet: bool) -> Iterator[Stage]:
    """Progress on standard error: a bar on a terminal, lines elsewhere."""
    with drawn(silent=quiet, announces=True) as progress:

        def begin(what: str, steps: int) -> Callable[[], None]:
            advance = progress.begin(what, steps)
            return lambda: advance(1)

        yield begin


def show(report: Report, *, as_json: bool) -> None:
    """Print a report to standard output, as a table or as JSON."""
    if as_json:
        console.out(report.to_json())
        return
    console.out(report.title)
    console.out(report.protocol.description)
    console.out("")
    for line in aligned(cells(report)):
        console.out(line)
    console.out("")
    for note in footnotes(report):
        console.out(note)


def write_text(text: str, path: Path) -> None:
    """Write a file.

    Raises:
        OutputError: it cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def cells(report: Report) -> list[list[str]]:
    """The table as text, header first."""
    return [_header(report), *(_cells(row, report) for row in report.rows)]


def _header(report: Report) -> list[str]:
    return ["row", "align", "images", *report.columns]


def _cells(row: ReportRow, report: Report) -> list[str]:
    name = console.one_line(row.name) + ("*" if row.note else "")
    scores = [
        "-" if math.isnan(value) else f"{value:.{_DECIMALS.get(metric, 4)}f}"
        for metric, value in row.items(boundary=report.protocol.boundary)
    ]
    return [name, row.alignment or "-", str(row.image_count), *scores]


def aligned(table: Sequence[Sequence[str]]) -> Iterator[str]:
    """Lines with text to the left and numbers to the right."""
    widths = [max(len(cell) for cell in column) for column in zip(*table, strict=True)]
    for cells in table:
        padded = [
            cell.ljust(width) if i < _TEXT_COLUMNS else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        yield "  ".join(padded).rstrip()


def footnotes(report: Report) -> list[str]:
    """What stands under the table."""
    marked = dict.fromkeys(f"* {console.one_line(row.note)}" for row in report.rows if row.note)
    empty = sorted({row.empty_count for row in report.rows} - {0})
    left_out = [f"{count} images have no valid pixel and are excluded" for count in empty]
    upward = {name for name, metric in METRICS.items() if metric.higher_is_better}
    direction = ", ".join(c for c in report.columns if c in upward | HIGHER_IS_BETTER)
    return [
        f"higher is better for {direction}, lower for the others",
        *marked,
        *report.notes,
        *left_out,
    ]
