"""Print the differences of one method from the others over their seeds, as JSON.

Run ``python docs/seed_intervals.py REPORT.json proposed`` on a report of ``eval nyu --json
--per-image``. Models whose names differ only in ``-seedK`` are seeds of one method: scores of an
image are averaged over them, and intervals are those of ``eval nyu --against``.
"""

import re
import sys
from dataclasses import replace
from pathlib import Path

from depthcli.lab.evaluation.evaluate import differences_from
from depthcli.lab.evaluation.report import EvalReport, ReportRow, Source
from depthcli.lab.evaluation.saved import read_report


def seed_intervals(report: EvalReport, name: str) -> EvalReport:
    """The differences of a method from each other of a report, without the report's rows."""
    groups: dict[str, list[ReportRow]] = {}
    for row in report.rows:
        if row.source is Source.MODEL:
            groups.setdefault(re.sub(r"-seed\d+$", "", row.name), []).append(row)
    intervals = differences_from(name, groups, report.scenes)
    return replace(report, rows=(), differences=intervals, scenes={})


if __name__ == "__main__":
    sys.stdout.write(seed_intervals(read_report(Path(sys.argv[1])), sys.argv[2]).to_json() + "\n")
