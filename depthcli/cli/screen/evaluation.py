"""Printing the table of an evaluation and writing its files."""

from collections.abc import Sequence

from depthcli.cli.screen import console
from depthcli.evaluation.report import EvalReport
from depthcli.evaluation.reports.figures import Figure
from depthcli.evaluation.reports.text import Page
from depthcli.evaluation.runs_report import RunsReport
from depthcli.jobs.evaluate.files import EvaluationFiles


def print_report(
    report: EvalReport | RunsReport,
    page: Page,
    figures: Sequence[Figure],
    files: EvaluationFiles,
    *,
    as_json: bool,
    quiet: bool,
) -> None:
    """Print the table as JSON or text, write the files, and print the names of the figures."""
    console.out(report.to_json() if as_json else page.to_text())
    for path in files.write(page, report.to_csv(), figures):
        if not (quiet or as_json):
            console.note(str(path))
