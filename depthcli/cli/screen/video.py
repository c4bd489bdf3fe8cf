"""Running one video and saying what became of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.cli.screen.predict import tell_failed
from depthcli.cli.screen.progress import drawn
from depthcli.errors import ExitCode, InputError, OutputError
from depthcli.inference.pipeline import Pipeline
from depthcli.jobs.failed import Failed
from depthcli.jobs.video.run import run_video

if TYPE_CHECKING:
    from depthcli.core.choices import Detail
    from depthcli.core.parallel.background import Background
    from depthcli.inference.session import Session
    from depthcli.jobs.video.plan import VideoJob
    from depthcli.jobs.video.result import VideoDone
    from depthcli.jobs.video.stages import VideoSettings


def run_and_tell(
    job: VideoJob,
    loading: Background[Session],
    settings: VideoSettings,
    detail: Detail,
    *,
    as_json: bool,
    quiet: bool,
) -> int:
    """Run a video to its end.

    Returns:
        The exit code.

    Raises:
        ModelError: the model cannot be used.
        UsageError: the options do not fit the model.
    """
    pipeline = Pipeline(loading.result(), detail)
    try:
        with drawn(silent=quiet or as_json) as progress:
            done = run_video(job, pipeline, settings, progress)
    except (InputError, OutputError) as error:
        tell_failed(Failed(job.name, error), as_json=as_json)
        return ExitCode.SOME_FAILED
    _tell(done, as_json=as_json, quiet=quiet)
    return ExitCode.SOME_FAILED if done.problem else ExitCode.OK


def _tell(done: VideoDone, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        console.out_json(done.as_json())
    elif not quiet:
        console.out(done.as_text())
        for warning in done.warnings:
            console.warn(f"{done.name}: {warning}")
    if done.problem:
        console.error(f"{done.name}: {done.problem}; the {done.frames} frames read are written")
