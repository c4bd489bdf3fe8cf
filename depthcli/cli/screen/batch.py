"""Output of a batch: for each input, and a summary."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass

from depthcli.cli.screen import console
from depthcli.cli.screen.progress import show_progress
from depthcli.core.interrupt import Interrupt
from depthcli.core.text import one_line
from depthcli.errors import SIGNAL_BASE, Message, ModelError, UsageError
from depthcli.io.listing.skipped import skip_summary
from depthcli.jobs.batch.dry_run import DryRunResult
from depthcli.jobs.batch.input_plan import Plan
from depthcli.jobs.batch.run import Batch
from depthcli.jobs.batch.tally import Tally
from depthcli.jobs.batch.task import Result


@dataclass(frozen=True, slots=True)
class StopOnSignal:
    """A :class:`depthcli.core.progress.Progress` that ends the work after a signal."""

    interrupt: Interrupt  #: records the signal

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[int], None]:
        """A stage that checks for a signal after each unit."""
        del what, total, unit
        return lambda _count: self.check()

    def check(self) -> None:
        """Raise SystemExit if a signal came."""
        if self.interrupt.number is not None:
            raise SystemExit(SIGNAL_BASE + self.interrupt.number)


@dataclass(frozen=True, slots=True)
class BatchScreen:
    """Prints the results of a batch."""

    as_json: bool  #: print one JSON object per input
    quiet: bool  #: print errors only

    def run(self, batch: Batch, plan: Plan, stop: StopOnSignal) -> None:
        """Run a batch, and print its results."""
        for warning in () if self.quiet else batch.warnings:
            console.warn(warning)
        resumes = True
        try:
            with show_progress(silent=self.quiet or self.as_json) as progress, closing(batch):
                stage = progress.begin("", batch.tally.total, "inputs")
                for result in batch:
                    self._print(result)
                    failed = len(batch.tally.failures)
                    stage.note = f"{failed} failed" if failed else ""
                    (stage.skip if result.is_kept else stage)(1)
                    stop.check()
        except ModelError:
            stop.check()  # the network was stopped
            raise
        except UsageError:
            resumes = False
            raise
        finally:
            for result in batch.late:
                self._print(result)
            self._print_summary(plan, batch, resumes=resumes)

    def _print(self, result: Result) -> None:
        if self.as_json:
            console.out_json(result.row.as_json() | {"kept": result.is_kept})
        elif not self.quiet and not result.is_kept:
            for warning in result.row.warnings:
                console.warn(f"{result.row.input}: {warning}")

    def _print_summary(self, plan: Plan, batch: Batch, *, resumes: bool) -> None:
        """Print the failures, then the counts."""
        tally = batch.tally
        for name, reason in tally.failures:
            if name not in reason:
                fact = reason if isinstance(reason, Message) else Message(reason)
                reason = fact.about(name)  # noqa: PLW2901
            console.error(reason)
        if batch.stopped:
            console.error(f"stopped because {batch.stopped}; fix the cause and run it again")
        if tally.failures and self.quiet:
            console.note(f"{len(tally.failures)} of {tally.total} inputs failed")
        if self.quiet:
            return
        for loop in plan.loops:
            console.warn(f"{loop} is a link to a folder above it; skipped")
        say = console.note if self.as_json else console.report
        speed = f"{tally.elapsed_s:.1f} s, {tally.rate:.1f} inputs/s"
        say(f"{', '.join(_counts(plan, tally))}; {speed}")
        if resumes and tally.completed < tally.total and not batch.stopped:
            console.note("stopped early; run the same command again to resume")
        if batch.manifest.exists():  # the disk may have been too full for it
            say(one_line(f"manifest: {batch.manifest}"))


def _counts(plan: Plan, tally: Tally) -> list[str]:
    parts = [f"{tally.done - len(tally.failures)} of {tally.total} inputs done"]
    if tally.kept:
        parts.append(f"{tally.kept} already done")
    if tally.failures:
        parts.append(f"{len(tally.failures)} failed")
    if plan.skipped:
        parts.append(skip_summary(plan.skipped))
    return parts


def print_dry_run(results: Iterable[DryRunResult], plan: Plan, *, as_json: bool) -> int:
    """Print what would be done for each input, and the counts; the number that would fail."""
    for warning in plan.warnings:
        console.warn(warning)
    counts = {"do": 0, "keep": 0, "fail": 0}
    for one in results:
        counts[one.would] += 1
        paths = [str(path) for path in one.outputs]
        _print_dry_run_result(one.would, one.input, paths, one.error, as_json=as_json)
    for file in plan.skipped:
        _print_dry_run_result("skip", file.name, [], file.reason, as_json=as_json)
    rest = f"; {skip_summary(plan.skipped)}" if plan.skipped else ""
    console.note(
        f"would process {counts['do']}, keep {counts['keep']} already done, fail "
        f"{counts['fail']}{rest}"
    )
    return counts["fail"]


def _print_dry_run_result(
    what: str, name: str, outputs: Sequence[str], problem: str | None, *, as_json: bool
) -> None:
    if as_json:
        console.out_json({"input": name, "would": what, "outputs": outputs, "error": problem})
    else:
        result = f": {problem}" if problem else f" -> {', '.join(outputs)}"
        console.out(one_line(f"{what:<4}  {name}{result}"))
