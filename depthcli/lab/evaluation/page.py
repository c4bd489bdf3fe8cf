"""The report of an evaluation as text, and as one HTML file without scripts."""

import base64
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import chain, groupby, repeat
from pathlib import Path
from string import Template

from depthcli.core.options import one_line
from depthcli.io.stored.metadata import SOFTWARE
from depthcli.lab.evaluation import report as reports
from depthcli.lab.evaluation.figures import Figure
from depthcli.lab.metrics.boundary import HIGHER_IS_BETTER
from depthcli.lab.metrics.depth import METRICS, Scores
from depthcli.lab.options import Part

_TRAINING = ("paired", "seeds", "epochs", "steps", "minutes", "params", "ms")
_DECIMALS = {"silog": 2, "dbe_acc": 2, "dbe_comp": 2}
_FEW_SCENES = 12  # with fewer, simulated intervals hold the true difference in less than 90 %
_TEXT_COLUMNS = 2
_HTML = Template(Path(__file__).with_name("page.html").read_text("utf-8"))


@dataclass(frozen=True, slots=True)
class Page:
    """The text of a report."""

    title: str  #: data set, split, number of images and protocol
    subtitle: str  #: description of the protocol
    table: Sequence[Sequence[str]]  #: cells as text, header first
    notes: Sequence[str]  #: footnotes
    #: title and cells of further tables: differences from each row that is compared, and parts
    sections: Sequence[tuple[str, Sequence[Sequence[str]]]] = ()
    models: Sequence[str] = ()  #: name and checksum of each model, for HTML only

    def to_text(self) -> str:
        """The report as plain text."""
        lines = [self.title, self.subtitle, "", *_aligned(self.table)]
        for title, table in self.sections:
            lines += ["", title, "", *_aligned(table)]
        return "\n".join([*lines, "", *self.notes])


def report_page(report: reports.EvalReport) -> Page:
    """The text of a report."""
    training = _TRAINING if report.has_training else ()
    models = (model for row in report.rows for model in row.seeds or (row,))
    checksums = (f"{row.name} sha256 {row.model_sha256}" for row in models if row.model_sha256)
    header = ["row", "align", *training, "images", "pixels", *report.columns]
    return Page(
        report.title,
        report.protocol.description,
        [header, *(_row_cells(row, report) for row in report.rows)],
        _footnotes(report),
        [*_differences(report.differences), *_parts(report.breakdowns)],
        list(dict.fromkeys(map(one_line, checksums))),
    )


def _row_cells(row: reports.ReportRow, report: reports.EvalReport) -> list[str]:
    return [
        one_line(row.name) + ("*" if row.note else ""),
        row.alignment or "-",
        *(_training_cells(row.training) if report.has_training else ()),
        str(row.image_count),
        str(row.pixel_count or "-"),
        *(_number(name, row.scores.get(name, math.nan), row.std) for name in report.columns),
    ]


def _number(metric: str, value: float, std: Scores | None = None) -> str:
    decimals = _DECIMALS.get(metric, 4)
    spread = f"±{std[metric]:.{decimals}f}" if std and metric in std else ""
    return "-" if math.isnan(value) else f"{value:.{decimals}f}{spread}"


def _training_cells(training: reports.Training | None) -> list[str]:
    if training is None:
        return ["-"] * len(_TRAINING)
    epochs, steps = (
        "-".join(map(str, sorted({min(values), max(values)})))
        for values in (training.epochs, training.steps)
    )
    return [
        "yes" if training.paired else "no",
        str(len(training.seeds)),
        f"{epochs}/{training.epochs_planned}",
        steps,
        f"{sum(training.minutes) / len(training.minutes):.1f}",
        f"{training.parameters / 1e6:.2f}M",
        f"{training.latency_ms:.1f}",
    ]


def _footnotes(report: reports.EvalReport) -> list[str]:
    upward = {name for name, metric in METRICS.items() if metric.higher_is_better}
    higher = ", ".join(name for name in report.columns if name in upward | HIGHER_IS_BETTER)
    units, depths = defaultdict[str, list[str]](list), defaultdict[str, list[str]](list)
    for metric in METRICS.values():
        units[metric.unit].append(metric.name)
    units.pop("", None)
    in_units = "".join(f"; {' and '.join(names)} in {unit}" for unit, names in units.items())
    for row in report.rows:
        if row.source is not reports.Source.PUBLISHED:
            depths[row.stated].append(one_line(row.name))
    kinds = (f"{depth} ({', '.join(dict.fromkeys(rows))})" for depth, rows in depths.items())
    empty = sorted({row.empty_count for row in report.rows} - {0})
    return [
        f"higher is better for {higher}, lower for the others{in_units}",
        *([f"predictions: {'; '.join(kinds)}"] if depths else []),
        *dict.fromkeys(f"* {one_line(row.note)}" for row in report.rows if row.note),
        *report.notes,
        *(f"{count} images have no valid pixel and are excluded" for count in empty),
    ]


def _differences(
    differences: Sequence[reports.Difference],
) -> Iterator[tuple[str, list[list[str]]]]:
    """Title and cells of each comparison, header first: means and bounds of the intervals."""
    for name, members in groupby(differences, lambda difference: difference.name):
        group, lines = list(members), [["minus", "align", "", *METRICS]]
        for difference in group:
            intervals = difference.intervals
            means = (_signed(i.mean, "!" if i.is_significant else " ") for i in intervals)
            lines += [
                [one_line(difference.other), difference.alignment or "-", "mean", *means],
                ["", "", "low", *(_signed(i.low) for i in intervals)],
                ["", "", "high", *(_signed(i.high) for i in intervals)],
            ]
        yield f"{one_line(name)} minus each row: mean{_interval(group[0].scene_count)}", lines


def _interval(scenes: int) -> str:
    if scenes == 1:
        return "; 1 scene: no interval"
    few = "; of so few, the intervals are too narrow" if scenes < _FEW_SCENES else ""
    return f" and 95 % interval over {scenes} scenes; ! excludes 0{few}"


def _parts(breakdowns: Sequence[reports.Breakdown]) -> Iterator[tuple[str, list[list[str]]]]:
    """Title and cells of each breakdown, header first."""
    for breakdown in breakdowns:
        unit = "pixels" if breakdown.by is Part.DISTANCE else "images"
        lines = [[str(breakdown.by), "row", unit, *METRICS]]
        for part in breakdown.scored:
            scores = (_number(metric, part.scores[metric]) for metric in METRICS)
            lines.append([one_line(part.part), one_line(part.row), str(part.count), *scores])
        yield breakdown.title, lines


def _signed(value: float, mark: str = " ") -> str:
    """A number with a last character that keeps the digits of a column in line."""
    return ("-" if math.isnan(value) else f"{value:+.4f}") + mark


def _aligned(table: Sequence[Sequence[str]]) -> Iterator[str]:
    """Lines with text columns left-aligned and numbers right-aligned."""
    widths = [max(len(cell) for cell in column) for column in zip(*table, strict=True)]
    for cells in table:
        padded = [
            cell.ljust(width) if i < _TEXT_COLUMNS else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        yield "  ".join(padded).rstrip()


def html_page(page: Page, figures: Sequence[Figure] = ()) -> str:
    """The content of the HTML file, with embedded figures."""
    titled = "".join(f"<p>{escape(name)}</p>\n{_html_table(rows)}" for name, rows in page.sections)
    return _HTML.substitute(
        title=escape(page.title),
        subtitle=escape(page.subtitle),
        tables=_html_table(page.table) + titled,
        notes="".join(f"<li>{escape(note)}</li>\n" for note in page.notes),
        figures="".join(map(_html_figure, figures)),
        footer="<br>".join(map(escape, (SOFTWARE, *page.models))),
    )


def _html_table(table: Sequence[Sequence[str]]) -> str:
    head, *rows = (
        "".join(f"<{tag}>{escape(text)}</{tag}>" for text in cells)
        for tag, cells in zip(chain(["th"], repeat("td")), table, strict=False)
    )
    body = "".join(f"<tr>{row}</tr>\n" for row in rows)
    head = f'<div class="scroll"><table>\n<thead><tr>{head}</tr></thead>\n'
    return f"{head}<tbody>\n{body}</tbody></table></div>\n"


def _html_figure(figure: Figure) -> str:
    data, caption = base64.b64encode(figure.png).decode("ascii"), escape(figure.caption)
    image = f'<img alt="{caption}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>\n"
