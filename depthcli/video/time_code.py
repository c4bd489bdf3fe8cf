"""SMPTE time codes (ST 12-1) of videos: in their headers, and counted by frames."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fractions import Fraction

    from av.container import InputContainer
    from av.video.stream import VideoStream

    from depthcli.video.rates import Timing

TimeCode = tuple[int, ...]
"""Hours, minutes, seconds, frame, drop-frame flag and further numbers, as a ``Frame`` has it."""
_TEXT = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d\d)", re.ASCII)
_KEY = "timecode"
_FURTHER = (0,) * 13  # flags and binary groups, which containers do not state
_DAY_MINUTES = 24 * 60
_MOST_FPS = 60
_TOLERANCE = 0.002  # 30000/1001 frames a second are counted as 30


def header_time_code(container: InputContainer, stream: VideoStream) -> TimeCode | None:
    """The time code of a video's first frame, as its file states it; None if it does not."""
    tables = (stream.metadata, container.metadata, *(other.metadata for other in container.streams))
    texts = (text for table in tables for key, text in table.items() if key.lower() == _KEY)
    match = next(filter(None, map(_TEXT.fullmatch, texts)), None)
    if match is None:
        return None
    hours, minutes, seconds, frame = (int(match[i]) for i in (1, 2, 3, 5))
    return hours, minutes, seconds, frame, int(match[4] != ":"), *_FURTHER


def time_code_after(start: TimeCode, frames: int, rate: Fraction) -> TimeCode | None:
    """The time code a number of frames later.

    Of a drop-frame time code, two numbers of 30 are left out every minute, except every tenth.

    Args:
        start: of the first frame.
        frames: how many; not negative.
        rate: frames a second.

    Returns:
        The time code; None if frames of this rate are not counted so.
    """
    hours, minutes, seconds, number, is_drop, *further = start
    base = round(rate)
    dropped = base // 15 if is_drop else 0
    is_counted = 0 < base <= _MOST_FPS and abs(rate / base - 1) < _TOLERANCE
    if not is_counted or (dropped and base % 30):
        return None
    minute = 60 * base - dropped
    ten_minutes = 10 * minute + dropped
    minutes += 60 * hours
    count = (60 * minutes + seconds) * base + number - dropped * (minutes - minutes // 10)
    tens, rest = divmod((count + frames) % (_DAY_MINUTES // 10 * ten_minutes), ten_minutes)
    left_out = dropped * (max(0, rest - dropped) // minute)
    seconds, number = divmod(tens * 600 * base + rest + left_out, base)
    return seconds // 3600, seconds // 60 % 60, seconds % 60, number, is_drop, *further


def time_code_text(time_code: TimeCode) -> str:
    """``01:02:03:04``; with ``;`` before the frame, if it is a drop-frame time code."""
    hours, minutes, seconds, frame, is_drop = time_code[:5]
    return f"{hours:02d}:{minutes:02d}:{seconds:02d}{':;'[is_drop]}{frame:02d}"


def time_code_label(first: TimeCode | None, timing: Timing) -> dict[str, str]:
    """Metadata from which FFmpeg writes the time code of a file's first frame; empty for none."""
    if first is None or not timing.has_all_frames:
        return {}
    counted = time_code_after(first, 0, timing.rate)
    return {} if counted is None else {_KEY: time_code_text(counted)}
