"""The table of an evaluation as text."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from depthcli.core.text import one_line
from depthcli.evaluation.report import EvalReport, ReportRow
from depthcli.evaluation.reports.differences_text import differences_table
from depthcli.metrics.boundary import HIGHER_IS_BETTER
from depthcli.metrics.depth import METRICS

_DECIMALS = {"silog": 2, "dbe_acc": 2, "dbe_comp": 2}
_TEXT_COLUMNS = 2


@dataclass(frozen=True, slots=True)
class Page:
    """The text of a report."""

    title: str  #: data set, split, number of images and protocol
    subtitle: str  #: description of the protocol
    table: Sequence[Sequence[str]]  #: cells as text, header first
    notes: Sequence[str]  #: footnotes
    #: title and cells of the table of differences; None if there is none
    differences: tuple[str, Sequence[Sequence[str]]] | None = None
    models: Sequence[str] = ()  #: name and checksum of each model, for HTML only

    def to_text(self) -> str:
        """The report as plain text."""
        lines = [self.title, self.subtitle, "", *_aligned(self.table)]
        if self.differences:
            title, table = self.differences
            lines += ["", title, "", *_aligned(table)]
        return "\n".join([*lines, "", *self.notes])


def report_page(report: EvalReport) -> Page:
    """The text of a report."""
    header = ["row", "align", "images", *report.columns]
    table = [header, *(_table_row(row, report) for row in report.rows)]
    return Page(
        report.title,
        report.protocol.description,
        table,
        _report_footnotes(report),
        differences_table(report.differences, tuple(METRICS)),
        model_checksums(report.rows),
    )


def model_checksums(rows: Iterable[ReportRow]) -> list[str]:
    """Name and checksum of each model of a table."""
    named = (f"{row.name} sha256 {row.model_sha256}" for row in rows if row.model_sha256)
    return list(dict.fromkeys(map(one_line, named)))


def _table_row(row: ReportRow, report: EvalReport) -> list[str]:
    name = one_line(row.name) + ("*" if row.note else "")
    scores = [
        "-" if math.isnan(value) else f"{value:.{_DECIMALS.get(metric, 4)}f}"
        for metric, value in row.items(boundary=report.protocol.boundary)
    ]
    return [name, row.alignment or "-", str(row.image_count), *scores]


def _aligned(table: Sequence[Sequence[str]]) -> Iterator[str]:
    """Lines with text columns left-aligned and numbers right-aligned."""
    widths = [max(len(cell) for cell in column) for column in zip(*table, strict=True)]
    for cells in table:
        padded = [
            cell.ljust(width) if i < _TEXT_COLUMNS else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        yield "  ".join(padded).rstrip()


def _report_footnotes(report: EvalReport) -> list[str]:
    """The footnotes of the table."""
    marked = dict.fromkeys(f"* {one_line(row.note)}" for row in report.rows if row.note)
    empty = sorted({row.empty_count for row in report.rows} - {0})
    left_out = [f"{count} images have no valid pixel and are excluded" for count in empty]
    upward = {name for name, metric in METRICS.items() if metric.higher_is_better}
    direction = ", ".join(c for c in report.columns if c in upward | HIGHER_IS_BETTER)
    return [
        f"higher is better for {direction}, lower for the others; sq_rel and rmse in metres",
        *marked,
        *report.notes,
        *left_out,
    ]
