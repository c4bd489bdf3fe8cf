"""Output for each picture, as text or JSON."""

from depthcli.cli.screen import console
from depthcli.core.summary import DepthRange
from depthcli.core.text import one_line
from depthcli.io.formats.metadata import DepthMetadata, anchor_fields, camera_text
from depthcli.jobs.failed import FailedInput
from depthcli.jobs.predict.pictures import PictureResult


def print_picture(
    result: PictureResult | FailedInput, *, as_json: bool, quiet: bool, to_stderr: bool
) -> None:
    """Print the result of an input as one JSON object or as text; with ``quiet``, only errors.

    Text goes to standard error if standard output carries a depth map.
    """
    if isinstance(result, FailedInput):
        print_failed(result, as_json=as_json)
    elif as_json:
        console.out_json(picture_json(result))
    elif not quiet:
        (console.note if to_stderr else console.report)(picture_text(result))
        for warning in result.warnings:
            console.warn(f"{result.name}: {warning}")


def print_failed(failed: FailedInput, *, as_json: bool) -> None:
    """Print that an input failed, and why."""
    reason = str(failed.error)
    if as_json:
        console.out_json({"input": failed.name, "status": "failed", "error": reason})
    console.error(reason if reason.startswith(failed.name) else f"{failed.name}: {reason}")


def picture_json(done: PictureResult) -> dict[str, object]:
    """The fields of one line of ``--json``."""
    known = DepthMetadata.of(done.depth)
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
        **anchor_fields(done.depth),
        "provider": done.provider,
        "seconds": round(done.seconds, 6),
        "warnings": list(done.warnings),
    }


def picture_text(done: PictureResult) -> str:
    """One line: outputs, range of depth, camera."""
    files = f"{one_line(done.name)} -> {', '.join(map(one_line, done.outputs))}"
    spread = DepthRange.of(done.depth)
    if spread.min is None:
        return f"{files}  no depth"
    unit = " m" if done.depth.is_metric else f" ({done.depth.kind}, no unit)"
    numbers = f"min {spread.min:.3f}, median {spread.median:.3f}, max {spread.max:.3f}{unit}"
    camera = camera_text(done.depth)
    return f"{files}  {numbers}" + (f"  camera: {camera}" if camera else "")
