"""Output of conversions, as text or JSON."""

from collections.abc import Generator
from contextlib import closing
from dataclasses import asdict, dataclass

from depthcli.cli.screen import console
from depthcli.cli.screen.predict import print_failed
from depthcli.cli.screen.progress import show_progress
from depthcli.core.text import one_line
from depthcli.io.listing.skipped import skip_summary
from depthcli.jobs.convert import ConvertResult
from depthcli.jobs.convert_folder import FolderPlan
from depthcli.jobs.failed import FailedInput

_NOT_READ_BACK = {"max_error": None, "mean_error": None, "lost": None}


def print_conversion(done: ConvertResult, *, as_json: bool, quiet: bool) -> None:
    """Print the conversion of one file: a JSON object, or a line and the warnings."""
    if as_json:
        console.out_json({"input": done.source, **_outcome(done)})
    elif not quiet:
        console.report(one_line(_conversion_text(done)))
        for warning in done.warnings:
            console.warn(warning)


def print_frames(
    results: Generator[ConvertResult, None, None], *, as_json: bool, quiet: bool
) -> None:
    """Print the conversions of a video's frames: a JSON object each, or a line and a warning."""
    totals, first, warned, written = _Totals(), "", 0, list[str]()
    with show_progress(silent=quiet or as_json) as progress, closing(results):
        advance = progress.begin("", None, "frames")
        for result in results:
            totals.add(result)
            written = [*written[:1], result.target]
            if as_json:
                console.out_json({"input": result.source, "status": "ok", **_outcome(result)})
            first = first or "; ".join(result.warnings)
            warned += bool(result.warnings)
            advance(1)
    if not quiet:
        (console.note if as_json else console.report)(
            one_line(f"{totals.converted} frames -> {' to '.join(written)}{totals.text()}")
        )
        if warned and not as_json:
            console.warn(f"{warned} frames have warnings, the first: {first}")


@dataclass(frozen=True, slots=True)
class FolderScreen:
    """Prints the conversions of a folder: a JSON object each, or failures and a summary."""

    as_json: bool  #: print one JSON object per input
    quiet: bool  #: print errors only

    def run(
        self, results: Generator[ConvertResult | FailedInput, None, None], plan: FolderPlan
    ) -> int:
        """Print the results of a plan while they are made; return how many inputs failed."""
        failures: list[FailedInput] = []
        totals = _Totals()
        for loop in () if self.quiet else plan.loops:
            console.warn(f"{loop} is a link to a folder above it; skipped")
        with show_progress(silent=self.quiet or self.as_json) as progress, closing(results):
            stage = progress.begin("", len(plan.inputs), "files")
            for result in results:
                if isinstance(result, FailedInput):
                    failures.append(result)
                    stage.note = f"{len(failures)} failed"
                else:
                    totals.add(result)
                self._print(result)
                stage(1)
        if not self.as_json:
            for failed in failures:
                print_failed(failed, as_json=False)
        self._print_summary(totals, plan, len(failures))
        return len(failures)

    def _print(self, result: ConvertResult | FailedInput) -> None:
        if isinstance(result, FailedInput):
            if self.as_json:
                print_failed(result, as_json=True)
        elif self.as_json:
            console.out_json({"input": result.source, "status": "ok", **_outcome(result)})
        elif not self.quiet:
            for warning in result.warnings:
                about = "" if warning.startswith(result.source) else f"{result.source}: "
                console.warn(f"{about}{warning}")

    def _print_summary(self, totals: "_Totals", plan: FolderPlan, failed: int) -> None:
        parts = [f"{totals.converted} of {len(plan.inputs)} files converted"]
        if failed:
            parts.append(f"{failed} failed")
        if plan.skipped:
            parts.append(skip_summary(plan.skipped))
        if not self.quiet:
            (console.note if self.as_json else console.report)(", ".join(parts) + totals.text())


@dataclass(slots=True)
class _Totals:
    """Counts and errors of all conversions."""

    converted: int = 0
    read_back: int = 0
    max_error: float = 0.0
    lost: int = 0
    is_metric: bool = True

    def add(self, done: ConvertResult) -> None:
        self.converted += 1
        if done.round_trip is not None:
            self.read_back += 1
            self.max_error = max(self.max_error, done.round_trip.max_error)
            self.lost += done.round_trip.lost
            self.is_metric &= done.depth.is_metric

    def text(self) -> str:
        """The largest round-trip error, if outputs were read back."""
        if not self.read_back:
            return ""
        unit = " m" if self.is_metric else ""
        return f"; round trip: max error {self.max_error:.3g}{unit}, {self.lost} pixels lost"


def _outcome(done: ConvertResult) -> dict[str, object]:
    return {
        "output": done.target,
        "unit": "m" if done.depth.is_metric else None,
        **(asdict(done.round_trip) if done.round_trip else _NOT_READ_BACK),
        "warnings": list(done.warnings),
    }


def _conversion_text(done: ConvertResult) -> str:
    line, trip = f"{done.source} -> {done.target}", done.round_trip
    if trip is not None:
        unit = " m" if done.depth.is_metric else ""
        line += (
            f"  round trip: max error {trip.max_error:.3g}{unit}, "
            f"mean {trip.mean_error:.3g}{unit}, {trip.lost} pixels lost"
        )
    return line
