"""SMPTE time codes in the headers of OpenEXR files, as plain numbers."""

from collections.abc import Mapping
from typing import Any

import OpenEXR

from depthcli.io.depth.exr_library import OPENEXR_ERRORS

_FIELDS = (
    *("hours", "minutes", "seconds", "frame"),
    *("dropFrame", "colorFrame", "fieldPhase", "bgf0", "bgf1", "bgf2"),
)
_GROUPS, _GROUP_BITS = 8, 4


def stated_time_code(header: Mapping[str, Any]) -> tuple[int, ...] | None:
    """The numbers of the time code that a header states; None if there is no valid one."""
    stated = header.get("timeCode")
    if not isinstance(stated, OpenEXR.TimeCode):
        return None
    shifts = range(0, _GROUPS * _GROUP_BITS, _GROUP_BITS)
    groups = (stated.userData >> shift & (1 << _GROUP_BITS) - 1 for shift in shifts)
    numbers = (*(int(getattr(stated, field)) for field in _FIELDS), *groups)
    try:
        time_code_attribute(numbers)
    except OPENEXR_ERRORS:  # 45 hours, for instance
        return None
    return numbers


def time_code_attribute(numbers: tuple[int, ...]) -> Any:  # noqa: ANN401 - OpenEXR has no types
    """The attribute of a header.

    Args:
        numbers: hours, minutes, seconds, frame; six flags (drop frame, colour frame, field phase,
            three of binary groups); eight binary groups of four bits.

    Raises:
        RuntimeError: one is out of its range.
    """
    return OpenEXR.TimeCode(*numbers)
