"""Parsing cameras, pixels and points of known depth."""

import math
from collections.abc import Sequence
from dataclasses import replace

from depthcli.core.camera import Anchor, Camera
from depthcli.core.camera_ranges import DEPTH_M
from depthcli.errors import InputError, UsageError
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.remote import path_of, safe_name

_PARTS = 3


def choose_camera(
    focal_px: float | None,
    hfov_deg: float | None,
    anchors: Sequence[str] | None,
    white_level: int | None = None,
    calibration: str | None = None,
    centre_px: str | None = None,
) -> Camera:
    """The camera of the options.

    Raises:
        UsageError: they contradict each other, an anchor is not X,Y,METRES, or the file of the
            calibration cannot be read.
    """
    check_alternatives(focal_px, hfov_deg, calibration, centre_px)
    camera = Camera(focal_px, hfov_deg, tuple(map(_anchor, anchors or ())), white_level)
    return camera if calibration is None else _calibrated(camera, calibration)


def check_alternatives(
    focal_px: float | None, hfov_deg: float | None, calibration: str | None, centre_px: str | None
) -> None:
    """Refuse options that state the same in two ways.

    Raises:
        UsageError: there are such options.
    """
    if focal_px is not None and hfov_deg is not None:
        raise UsageError("give --focal-px or --hfov, not both")
    others = {"--focal-px": focal_px, "--hfov": hfov_deg, "--centre-px": centre_px}
    for word in [word for word, value in others.items() if value is not None and calibration]:
        raise UsageError(f"give --calibration or {word}, not both")


def refuse_replacing(calibration: str | None, output: str | None) -> None:
    """Refuse an output in place of the calibration, which may be JSON as a sidecar is.

    Raises:
        UsageError: they are one file.
    """
    if calibration and output and is_same_file(path_of(output), path_of(calibration)):
        raise UsageError(f"{safe_name(output)} is the file of --calibration; choose another -o")


def _calibrated(camera: Camera, name: str) -> Camera:
    from depthcli.io.calibration import read_calibration

    try:
        found = read_calibration(name)
    except InputError as error:
        raise UsageError(f"--calibration: {error}") from error
    return replace(camera, hfov_deg=found.hfov_deg, calibration=found)


def parse_pixel(word: str) -> tuple[int, int]:
    """Parse ``X,Y``.

    Raises:
        UsageError: it is not two integers of at least 0.
    """
    try:
        x, y = (int(part) for part in word.split(","))
    except ValueError:
        x = y = -1
    if min(x, y) < 0:
        raise UsageError(
            f"{word!r} is not X,Y; give a column and a row from 0, for example 320,240"
        )
    return x, y


def parse_centre(word: str) -> tuple[float, float]:
    """Parse ``CX,CY``, in pixels with decimals.

    Raises:
        UsageError: it is not two finite numbers.
    """
    try:
        x, y = (float(part) for part in word.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise UsageError(
            f"--centre-px {word!r} is not CX,CY; give the principal point in pixels, for example "
            "319.5,239.5"
        )
    return x, y


def _anchor(word: str) -> Anchor:
    parts = word.split(",")
    try:
        x, y, depth_m = int(parts[0]), int(parts[1]), float(parts[2])
    except (ValueError, IndexError):
        x = y = -1
        depth_m = math.nan
    if len(parts) != _PARTS or min(x, y) < 0 or not DEPTH_M.holds(depth_m):
        raise UsageError(
            f"--anchor {word!r} is not X,Y,METRES; give a column and a row from 0 and "
            f"{DEPTH_M.what}, for example 320,240,2.5"
        )
    return Anchor(x, y, depth_m)
