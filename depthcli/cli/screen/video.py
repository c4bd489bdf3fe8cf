"""Output for a video, as text or JSON."""

from depthcli.cli.screen import console
from depthcli.cli.screen.predict import print_failed
from depthcli.core.text import one_line
from depthcli.errors import Message
from depthcli.jobs.failed import FailedInput
from depthcli.jobs.video.result import VideoResult


def print_video(
    result: VideoResult | FailedInput, *, as_json: bool, quiet: bool, to_stderr: bool
) -> None:
    """Print the result of a video as one JSON object or as text; with ``quiet``, only errors.

    Text goes to standard error if standard output carries a video.
    """
    if isinstance(result, FailedInput):
        print_failed(result, as_json=as_json)
        return
    if as_json:
        console.out_json(video_json(result))
    elif not quiet:
        (console.note if to_stderr else console.report)(video_text(result))
        for warning in result.warnings:
            console.warn(_about(result.name, warning))
    if result.problem:
        console.error(_about(result.name, f"{result.problem}; frames written: {result.frames}"))


def _about(name: str, text: str) -> str:
    """A message that begins with the name of what it is about."""
    return text.about(name) if isinstance(text, Message) else f"{name}: {text}"


def video_json(done: VideoResult) -> dict[str, object]:
    """The object of ``--json``."""
    return {
        "input": done.name,
        "status": "incomplete" if done.problem else "ok",
        "outputs": list(done.outputs),
        **done.metadata(),
        "provider": done.provider,
        "seconds": round(done.seconds, 6),
        "processed_fps": round(done.frames / done.seconds, 3),
        "warnings": [console.worded(warning) for warning in done.warnings],
        "error": done.problem,
    }


def video_text(done: VideoResult) -> str:
    """One line: outputs, number of frames, flicker, camera."""
    from depthcli.io.formats.metadata import camera_text

    files = f"{one_line(done.name)} -> {', '.join(map(one_line, done.outputs))}"
    frames = "1 frame" if done.frames == 1 else f"{done.frames} frames"
    flicker = "" if done.flicker is None else f", flicker {done.flicker:.2%} per frame"
    before = done.flicker_unsmoothed
    smoothed = "" if before is None else f" ({before:.2%} before smoothing)"
    camera = camera_text(done.depth)
    seen_by = f"  camera: {camera}" if camera else ""
    speed = f"{frames} at {done.rate} fps in {done.seconds:.1f} s"
    return f"{files}  {speed}{flicker}{smoothed}{seen_by}"
