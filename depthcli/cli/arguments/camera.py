"""Parsing cameras, pixels and points of known depth."""

import math
from collections.abc import Mapping
from typing import Any

from depthcli.core.camera import DEPTH_M, Anchor, Intrinsics
from depthcli.core.picture_options import ReadOptions
from depthcli.errors import InputError, UsageError
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.remote import path_of, safe_name

ALTERNATIVES = (("calibration", "cameras", "focal_px", "hfov"), ("calibration", "centre_px"))
"""Parameters of which only one is given, because they state the same."""
_PARTS = 3


def choose_camera(given: Mapping[str, Any]) -> Intrinsics:
    """The camera of the options.

    Args:
        given: values of the options by parameter name; those that are missing or None are not
            given.

    Raises:
        UsageError: they contradict each other, one is invalid, or the file of the calibration
            cannot be read.
    """
    camera, name = parse_camera(given), given.get("calibration")
    if name is None:
        return camera
    from depthcli.io.calibration import read_calibration

    try:
        return read_calibration(name, rectified=bool(given.get("rectified")))
    except InputError as error:
        raise UsageError(f"--calibration: {error}") from error


def parse_camera(given: Mapping[str, Any]) -> Intrinsics:
    """The camera of the options without what is in the file of a calibration.

    Args:
        given: as for :func:`choose_camera`.

    Raises:
        UsageError: they contradict each other, or one is invalid.
    """
    for names in ALTERNATIVES:
        words = [f"--{name.replace('_', '-')}" for name in names if given.get(name) is not None]
        if len(words) > 1:
            raise UsageError(f"give {words[0]} or {words[1]}, not both")
    if given.get("rectified") and given.get("calibration") is None:
        raise UsageError("--rectified is for --calibration; give both or neither")
    centre = given.get("centre_px")
    return Intrinsics.given(
        given.get("focal_px"),
        given.get("hfov"),
        None if centre is None else _centre(centre),
    )


def read_options(given: Mapping[str, Any]) -> ReadOptions:
    """How images are read, by the options of the same names."""
    return ReadOptions(given.get("white_level"), given.get("exposure") or 0.0, given.get("layer"))


def refuse_replacing(calibration: str | None, output: str | None) -> None:
    """Refuse an output in place of the calibration, which may be JSON as a sidecar is.

    Raises:
        UsageError: they are one file.
    """
    if calibration and output and is_same_file(path_of(output), path_of(calibration)):
        raise UsageError(f"{safe_name(output)} is the file of --calibration; choose another output")


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


def _centre(word: str) -> tuple[float, float]:
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


def parse_anchor(word: str) -> Anchor:
    """Parse ``X,Y,METRES``.

    Raises:
        UsageError: it is not a pixel and a depth.
    """
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
