"""What is said of a video, as text and as JSON."""

from depthcli.cli.screen import console
from depthcli.cli.screen.predict import print_failed
from depthcli.core.text import one_line
from depthcli.jobs.failed import Failed
from depthcli.jobs.video.result import VideoDone


def print_video(result: VideoDone | Failed, *, as_json: bool, quiet: bool, to_stderr: bool) -> None:
    """Say what became of a video: as one JSON object or as text; quiet says errors only.

    Text goes to standard error where standard output carries a video.
    """
    if isinstance(result, Failed):
        print_failed(result, as_json=as_json)
        return
    if as_json:
        console.out_json(video_json(result))
    elif not quiet:
        (console.note if to_stderr else console.say)(video_text(result))
        for warning in result.warnings:
            console.warn(f"{result.name}: {warning}")
    if result.problem:
        written = f"the {result.frames} frames read are written"
        console.error(f"{result.name}: {result.problem}; {written}")


def video_json(done: VideoDone) -> dict[str, object]:
    """The object of ``--json``."""
    return {
        "input": done.name,
        "status": "incomplete" if done.problem else "ok",
        "outputs": list(done.outputs),
        **done.facts(),
        "provider": done.provider,
        "seconds": round(done.seconds, 6),
        "processed_fps": round(done.frames / done.seconds, 3),
        "warnings": list(done.warnings),
        "error": done.problem,
    }


def video_text(done: VideoDone) -> str:
    """One line: where the outputs are, how many frames, how steady, the camera."""
    from depthcli.io.writers.facts import camera_words

    files = f"{one_line(done.name)} -> {', '.join(map(one_line, done.outputs))}"
    frames = "1 frame" if done.frames == 1 else f"{done.frames} frames"
    flicker = "" if done.flicker is None else f", flicker {done.flicker:.2%} per frame"
    before = done.flicker_unsmoothed
    smoothed = "" if before is None else f" ({before:.2%} before smoothing)"
    camera = camera_words(done.depth)
    seen_by = f"  camera: {camera}" if camera else ""
    speed = f"{frames} at {done.rate} fps in {done.seconds:.1f} s"
    return f"{files}  {speed}{flicker}{smoothed}{seen_by}"
