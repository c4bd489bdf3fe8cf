"""What a batch says: of each input, and at its end."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from depthcli.cli.screen import console
from depthcli.core.text import one_line
from depthcli.io.listing.skipped import summary
from depthcli.jobs.batch.manifest import MANIFEST_NAME

if TYPE_CHECKING:
    from collections.abc import Iterable

    from depthcli.jobs.batch.pictures import Result
    from depthcli.jobs.batch.plan import Plan
    from depthcli.jobs.batch.tally import Tally


class Voice(NamedTuple):
    """What is said, and where.

    Attributes:
        as_json: one JSON object a line for each input, on standard output.
        quiet: errors only.
    """

    as_json: bool
    quiet: bool

    def warn(self, warnings: Iterable[str]) -> None:
        """What is to be known of the whole batch."""
        for warning in () if self.quiet else warnings:
            console.warn(warning)

    def tell(self, result: Result) -> None:
        """What became of one input."""
        if self.as_json:
            console.out_json(result.row.as_json() | {"kept": result.is_kept})
        elif not self.quiet and not result.is_kept:
            for warning in result.row.warnings:
                console.warn(f"{result.row.input}: {warning}")

    def sum_up(self, plan: Plan, tally: Tally) -> None:
        """The failures, then what was done."""
        for name, reason in tally.failures:
            console.error(reason if name in reason else f"{name}: {reason}")
        if tally.failures and self.quiet:
            console.note(f"{len(tally.failures)} of {tally.total} inputs failed")
        if self.quiet:
            return
        for loop in plan.loops:
            console.warn(f"{loop} leads back to a folder that it is in; skipped")
        say = console.note if self.as_json else console.out
        say(", ".join(_account(plan, tally)) + f"; {_speed(tally)}")
        if tally.passed < tally.total:
            console.note("stopped early; run the same command again to resume")
        say(one_line(f"manifest: {plan.out / MANIFEST_NAME}"))


def _account(plan: Plan, tally: Tally) -> list[str]:
    parts = [f"{tally.done - len(tally.failures)} of {tally.total} inputs done"]
    if tally.kept:
        parts.append(f"{tally.kept} already done")
    if tally.failures:
        parts.append(f"{len(tally.failures)} failed")
    if plan.skipped:
        parts.append(summary(plan.skipped))
    return parts


def _speed(tally: Tally) -> str:
    return f"{tally.elapsed_s:.1f} s, {tally.rate:.1f} inputs/s"
