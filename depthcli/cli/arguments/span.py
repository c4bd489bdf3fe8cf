"""Parsing the part of a video to process, and its frame rate."""

import re
from fractions import Fraction
from typing import Any

from depthcli.cli.arguments.unused import given_options
from depthcli.core.text import short_repr
from depthcli.errors import UsageError
from depthcli.io.storage.remote import safe_name
from depthcli.video.frame_source import is_sequence
from depthcli.video.rates import exact_rate
from depthcli.video.single_picture import single_picture_advice
from depthcli.video.spans import Point, Span

_POINT = re.compile(r"(?:(\d+):)?(?:(\d+):)?(\d+(?:\.\d*)?|\.\d+)([sf]?)", re.ASCII)
_RATE = re.compile(r"(\d{1,9}(?:\.\d{1,6})?|\d{1,9}/(\d{1,9}))", re.ASCII)
_MINUTE = 60
_MAX_LENGTH = 40
"""Longest text that is parsed as a time."""


def parse_span(start: str | None, end: str | None, every: str | None) -> Span:
    """Parse ``--start``, ``--end`` and ``--every``.

    Raises:
        UsageError: one is not a time or frame number, or the span is empty.
    """
    first = parse_point("0" if start is None else start, "--start")
    last = None if end is None else parse_point(end, "--end")
    step = parse_point("1" if every is None else every, "--every", bare_is_frames=True)
    if not step.value:
        raise UsageError("--every 0 is not a step; give 1 or more")
    if last and first.in_frames == last.in_frames and last.value <= first.value:
        raise UsageError(f"--end {end} is not after --start {start or 0}; the span is empty")
    return Span(first, last, step)


def parse_fps(word: str | None) -> Fraction | None:
    """Parse ``--fps``.

    Raises:
        UsageError: it is not a frame rate.
    """
    if word is None:
        return None
    match = _RATE.fullmatch(word.strip())
    value = Fraction(match[0]) if match and Fraction(match[2] or 1) else None
    rate = None if value is None or "/" in word else exact_rate(value)
    found = value if "/" in word else rate
    if not found:
        raise UsageError(f"--fps {word!r} is not a frame rate; give 24, 23.976 or 24000/1001")
    return found


def refuse_for_videos(context: Any, file: str) -> None:  # noqa: ANN401 - typer's own
    """Refuse options of image sequences on the command line for a video; a profile may have them.

    Raises:
        UsageError: one is given, and the input is no image sequence.
    """
    words = given_options(context)
    given = [words[name] for name in ("fps", "white_level", "exposure", "layer") if name in words]
    if given and not is_sequence(file):
        name = safe_name(file)
        advice = single_picture_advice(name) or f"{name} is a video; leave it out"
        raise UsageError(f"{given[0]} is for image sequences, and {advice}")


def parse_point(word: str, option: str, *, bare_is_frames: bool = False) -> Point:
    """Parse ``12.5``, ``12.5s``, ``1:02.5``, ``1:00:00`` or ``300f`` of an option.

    A number without a unit is in seconds, or in frames with ``bare_is_frames``.

    Raises:
        UsageError: it is none of these.
    """
    match = _POINT.fullmatch(word.strip())
    if match is None or len(word) > _MAX_LENGTH:
        raise UsageError(
            f"{option} {short_repr(word)} is not a time or frame number; give seconds (12.5s), "
            "minutes (1:02.5) or "
            "a frame number (300f)"
        )
    outer, inner, number, letter = match.groups()
    parts = [int(part) for part in (outer, inner) if part is not None]
    in_frames = letter == "f" or (not letter and not parts and bare_is_frames)
    value = Fraction(number if number[-1] != "." else number[:-1])
    if in_frames and (parts or value.denominator > 1):
        raise UsageError(f"{option} {word!r} is not a frame number; give an integer such as 300f")
    for power, part in enumerate(reversed(parts), start=1):
        value += part * _MINUTE**power
    return Point(value, in_frames)
