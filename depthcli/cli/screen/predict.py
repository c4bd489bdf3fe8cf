"""What is said of each picture, as text and as JSON."""

from depthcli.cli.screen import console
from depthcli.core.summary import DepthRange
from depthcli.core.text import one_line
from depthcli.io.writers.facts import Facts, camera_words
from depthcli.jobs.failed import Failed
from depthcli.jobs.predict.pictures import Done


def print_picture(result: Done | Failed, *, as_json: bool, quiet: bool, to_stderr: bool) -> None:
    """Say what became of an input: as one JSON object a line or as text; quiet says errors only.

    Text goes to standard error where standard output carries a depth map.
    """
    if isinstance(result, Failed):
        print_failed(result, as_json=as_json)
    elif as_json:
        console.out_json(picture_json(result))
    elif not quiet:
        (console.note if to_stderr else console.say)(picture_text(result))
        for warning in result.warnings:
            console.warn(f"{result.name}: {warning}")


def print_failed(failed: Failed, *, as_json: bool) -> None:
    """Say that an input failed, and why."""
    reason = str(failed.error)
    if as_json:
        console.out_json({"input": failed.name, "status": "failed", "error": reason})
    console.error(reason if reason.startswith(failed.name) else f"{failed.name}: {reason}")


def picture_json(done: Done) -> dict[str, object]:
    """The fields of one line of ``--json``."""
    known = Facts.of(done.depth)
    return {
        "input": done.name,
        "status": "ok",
        "outputs": list(done.outputs),
        "kind": known.kind,
        "unit": known.unit,
        **DepthRange.of(done.depth)._asdict(),
        "width": done.depth.width,
        "height": done.depth.height,
        **known.origin(),
        "provider": done.provider,
        "seconds": round(done.seconds, 6),
        "warnings": list(done.warnings),
    }


def picture_text(done: Done) -> str:
    """One line: where the outputs are, the range of depth, and the camera it belongs to."""
    files = f"{one_line(done.name)} -> {', '.join(map(one_line, done.outputs))}"
    spread = DepthRange.of(done.depth)
    if spread.min is None:
        return f"{files}  no depth"
    unit = " m" if done.depth.is_metric else f" ({done.depth.kind}, no unit)"
    numbers = f"min {spread.min:.3f}, median {spread.median:.3f}, max {spread.max:.3f}{unit}"
    camera = camera_words(done.depth)
    return f"{files}  {numbers}" + (f"  camera: {camera}" if camera else "")
