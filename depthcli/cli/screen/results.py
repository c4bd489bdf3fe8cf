"""Output of the commands that process images, videos and depth files, as text or JSON."""

from __future__ import annotations

import sys
import time
from collections import Counter
from contextlib import closing
from dataclasses import asdict
from itertools import chain
from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.core import options, types
from depthcli.errors import EngineError, ModelError, UsageError, about
from depthcli.io.listing import skip_summary
from depthcli.io.stored.metadata import camera_text
from depthcli.jobs.image import FailedInput, depth_facts
from depthcli.jobs.predict import PredictResult

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable

    from depthcli.cli.options import ScreenOptions
    from depthcli.cli.shell import StopOnSignal
    from depthcli.jobs.batch.plan import BatchPlan
    from depthcli.jobs.batch.run import Batch, DryRun
    from depthcli.jobs.batch.tasks import BatchResult
    from depthcli.jobs.convert import ConvertResult, FolderPlan
    from depthcli.jobs.video.plan import VideoResult


def run_batch(batch: Batch, plan: BatchPlan, stop: StopOnSignal, screen: ScreenOptions) -> None:
    """Run a batch; print its results, as JSON objects or as warnings and failures, and a summary.

    With ``--quiet``, only errors are printed.
    """
    quiet, as_json, tally = screen.quiet, screen.as_json, batch.tally

    def show(result: BatchResult) -> None:
        if as_json:
            console.out_json(result.row.as_json() | {"kept": result.is_kept})
        elif not quiet and not result.is_kept:
            of_input = (text for text in result.row.warnings if text not in batch.warnings)
            console.warn_all(of_input, name=result.row.input)

    screen.warn_all(batch.warnings)
    try:
        with screen.show_progress() as progress, closing(batch):
            stage = progress.begin("", tally.total, "inputs")
            for result in batch:
                show(result)
                stage.note = f"{len(tally.failures)} failed" if tally.failures else ""
                stage.file = result.row.input
                (stage.skip if result.is_kept else stage)(1)
                stop.check()
    except (EngineError, ModelError):
        stop.check()  # the network or its process was stopped
        raise
    finally:
        for result in batch.late:
            show(result)
        _print_summary(batch, plan, screen)
        is_short = tally.completed < tally.total and not batch.stopped
        if is_short and not (quiet or isinstance(sys.exception(), UsageError)):
            console.note("stopped early; run the same command again to resume")


def _print_summary(batch: Batch, plan: BatchPlan, screen: ScreenOptions) -> None:
    tally, elapsed_s = batch.tally, time.monotonic() - batch.tally.start_s
    for name, reason in tally.failures:
        console.error(about(name, reason))
    if batch.stopped:
        console.error(f"stopped because {batch.stopped}; fix the cause and run it again")
    if screen.quiet:
        if tally.failures:
            console.note(f"{len(tally.failures)} of {tally.total} inputs failed")
        return
    _warn_of_loops(plan.loops)
    say = console.note if screen.as_json else console.out
    parts = [f"{tally.done - len(tally.failures)} of {tally.total} inputs done"]
    parts += [f"{tally.kept} already done"] if tally.kept else []
    parts += [f"{len(tally.failures)} failed"] if tally.failures else []
    parts += [skip_summary(plan.skipped)] if plan.skipped else []
    rate = tally.done / max(elapsed_s, 1e-9)
    say(f"{', '.join(parts)}; {elapsed_s:.1f} s, {rate:.1f} inputs/s")
    if batch.manifest.exists():  # the disk may have been too full for it
        say(options.one_line(f"manifest: {batch.manifest}"))


def _warn_of_loops(loops: Iterable[str]) -> None:
    console.warn_all(f"{loop} is a link to a folder above it; skipped" for loop in loops)


def print_dry_run(results: Iterable[DryRun], plan: BatchPlan, screen: ScreenOptions) -> int:
    """Print what would be done for each input, and the counts; the number that would fail."""
    screen.warn_all(plan.warnings)
    skipped = (("skip", file.name, (), file.reason) for file in plan.skipped)
    counts: Counter[str] = Counter()
    for would, name, outputs, problem in chain(results, skipped):
        counts[would] += 1
        paths, error = [str(path) for path in outputs], problem and console.worded(problem)
        if screen.as_json:
            console.out_json({"input": name, "would": would, "outputs": paths, "error": error})
        else:
            result = f": {error}" if error else f" -> {', '.join(paths)}"
            console.out(options.one_line(f"{would:<4}  {name}{result}"))
    rest = f"; {skip_summary(plan.skipped)}" if plan.skipped else ""
    if not screen.quiet:
        done = f"keep {counts['keep']} already done, fail {counts['fail']}"
        console.note(f"would process {counts['do']}, {done}{rest}")
    return counts["fail"]


def _print_failed(failed: FailedInput, screen: ScreenOptions) -> None:
    reason = failed.error.message
    if screen.as_json:
        error = console.worded(reason)
        console.out_json({"input": failed.name, "status": "failed", "error": error})
    console.error(about(failed.name, reason))


def print_result(
    result: PredictResult | VideoResult | FailedInput, screen: ScreenOptions, *, to_stderr: bool
) -> None:
    """Print the result of an input as one JSON object or as text; with ``--quiet``, only errors.

    Text goes to standard error if standard output carries depth.
    """
    if isinstance(result, FailedInput):
        _print_failed(result, screen)
        return
    if screen.as_json:
        console.out_json(_json_of(result))
    elif not screen.quiet:
        text = image_text(result) if isinstance(result, PredictResult) else video_text(result)
        (console.note if to_stderr else console.out)(text)
        console.warn_all(result.warnings, name=result.name)
    if not isinstance(result, PredictResult) and result.problem:
        console.error(about(result.name, f"{result.problem}; frames written: {result.frames}"))


def _json_of(done: PredictResult | VideoResult) -> dict[str, object]:
    """The fields of one line of ``--json``."""
    facts: dict[str, object] = {"input": done.name, "status": "ok", "outputs": list(done.outputs)}
    of_run = {"provider": done.provider, "seconds": round(done.seconds, 6)}
    warnings = {"warnings": [console.worded(warning) for warning in done.warnings]}
    if isinstance(done, PredictResult):
        return {**facts, **depth_facts(done.depth), **of_run, **warnings}
    facts["status"] = "incomplete" if done.problem else "ok"
    speed = {"processed_fps": round(done.frames / done.seconds, 3)}
    live = {"live": None if done.live is None else asdict(done.live)}
    error = {"error": done.problem}
    return {**facts, **done.metadata(), **of_run, **speed, **live, **warnings, **error}


def image_text(done: PredictResult) -> str:
    """One line: outputs, range of depth, camera."""
    facts = types.range_facts(done.depth)
    if facts["min"] is None:
        return _line(done, "no depth")
    unit = " m" if done.depth.is_metric else f" ({done.depth.kind}, no unit)"
    numbers = ", ".join(f"{name} {facts[name]:.3f}" for name in types.DepthRange._fields)
    error = f", expected error {facts['expected_error']:.0%}" if "expected_error" in facts else ""
    return _line(done, f"{numbers}{unit}{error}")


def _line(done: PredictResult | VideoResult, facts: str) -> str:
    files, camera = ", ".join(map(options.one_line, done.outputs)), camera_text(done.depth)
    seen_by = f"  camera: {camera}" if camera else ""
    return f"{options.one_line(done.name)} -> {files}  {facts}{seen_by}"


def video_text(done: VideoResult) -> str:
    """One line: outputs, number of frames, flicker, camera."""
    frames = "1 frame" if done.frames == 1 else f"{done.frames} frames"
    flicker = "" if done.flicker is None else f", flicker {done.flicker:.2%} per frame"
    before = done.flicker_unsmoothed
    smoothed = "" if before is None else f" ({before:.2%} before smoothing)"
    dropped = "" if done.live is None else f", {done.live.dropped} late frames dropped"
    rate = f" at {done.rate} fps" if done.live is None else ""
    return _line(done, f"{frames}{rate} in {done.seconds:.1f} s{dropped}{flicker}{smoothed}")


_NOT_READ_BACK = {"max_error": None, "mean_error": None, "lost": None}


def print_conversion(done: ConvertResult, screen: ScreenOptions) -> None:
    """Print the conversion of one file: a JSON object, or a line and the warnings."""
    if screen.as_json:
        console.out_json({"input": done.source, **_outcome(done)})
    elif not screen.quiet:
        line, trip, unit = f"{done.source} -> {done.target}", done.round_trip, _metres(done)
        if trip is not None:
            line += (
                f"  round trip: max error {trip.max_error:.3g}{unit}, "
                f"mean {trip.mean_error:.3g}{unit}, {trip.lost} pixels lost"
            )
        console.out(options.one_line(line))
        console.warn_all(done.warnings)


def print_conversions(
    results: Generator[ConvertResult | FailedInput, None, None],
    unit: str,
    screen: ScreenOptions,
    plan: FolderPlan | None = None,
) -> int:
    """Print many conversions while they are made: a JSON object each, or failures, and a summary.

    They are those of the files of a folder, which has a plan, or of the frames of a video. Returns
    how many inputs failed.
    """
    warned = list[str]()  # the first warning of each frame
    converted, failed, lost, max_error, in_metres = 0, 0, 0, -1.0, " m"
    _warn_of_loops(plan.loops if plan and not screen.quiet else ())
    with screen.show_progress() as progress, closing(results):
        stage = progress.begin("", len(plan.inputs) if plan else None, unit)
        for result in results:
            stage.file = result.name if isinstance(result, FailedInput) else result.source
            if isinstance(result, FailedInput):
                failed += 1
                stage.note = f"{failed} failed"
                _print_failed(result, screen)
            else:
                converted += 1
                if (trip := result.round_trip) is not None:
                    max_error, lost = max(max_error, trip.max_error), lost + trip.lost
                    in_metres = in_metres and _metres(result)
                warned += result.warnings[:1] if plan is None else ()
                if screen.as_json:
                    console.out_json({"input": result.source, "status": "ok", **_outcome(result)})
                elif plan and not screen.quiet:
                    console.warn_all(result.warnings, name=result.source)
            stage(1)
    if not screen.quiet:
        of = f" of {len(plan.inputs)}" if plan else ""
        parts = [f"{converted}{of} {unit} converted"]
        parts += [f"{failed} failed"] if failed else []
        parts += [skip_summary(plan.skipped)] if plan and plan.skipped else []
        trips = f"; round trip: max error {max_error:.3g}{in_metres}, {lost} pixels lost"
        text = ", ".join(parts) + (trips if max_error >= 0 else "")
        (console.note if screen.as_json else console.out)(text)
    if warned and screen.shows_text:
        first = console.worded(warned[0])
        console.warn(f"{len(warned)} {unit} have warnings, the first: {first}")
    return failed


def _metres(done: ConvertResult) -> str:
    return " m" if done.depth.is_metric else ""


def _outcome(done: ConvertResult) -> dict[str, object]:
    return {
        "output": done.target,
        "unit": done.depth.unit,
        **(asdict(done.round_trip) if done.round_trip else _NOT_READ_BACK),
        "warnings": [console.worded(warning) for warning in done.warnings],
    }
