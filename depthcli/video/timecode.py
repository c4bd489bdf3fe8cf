"""SMPTE time codes: reading that of a video, and counting frames from it (ST 12-1)."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fractions import Fraction

    from av.container import InputContainer
    from av.video.stream import VideoStream

_TEXT = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d{2,3})", re.ASCII)
_KEY = "timecode"
_DAY_MINUTES = 24 * 60
_TOLERANCE = 0.002  # 30000/1001 frames a second are counted as 30


def stated_timecode(container: InputContainer, stream: VideoStream) -> str | None:
    """The time code of a video's first frame, as its file states it; None if it does not."""
    tables = (stream.metadata, container.metadata, *(other.metadata for other in container.streams))
    texts = (text for table in tables for key, text in table.items() if key.lower() == _KEY)
    return next(filter(_TEXT.fullmatch, texts), None)


def timecode_after(start: str, frames: int, rate: Fraction) -> str | None:
    """The time code a number of frames later.

    Args:
        start: ``01:02:03:04``; with ``;`` before the frames, it is a drop-frame time code: two
            numbers of 30 are left out every minute, except every tenth.
        frames: how many; not negative.
        rate: frames a second.

    Returns:
        The time code; None if the text is none, or frames of this rate are not counted so.
    """
    match, base = _TEXT.fullmatch(start), round(rate)
    if match is None or not base or abs(rate / base - 1) > _TOLERANCE:
        return None
    hours, minutes, seconds, number = (int(match[i]) for i in (1, 2, 3, 5))
    dropped = 0 if match[4] == ":" else base // 15
    if dropped and base % 30:
        return None
    minute = 60 * base - dropped
    ten_minutes = 10 * minute + dropped
    minutes += 60 * hours
    count = (60 * minutes + seconds) * base + number - dropped * (minutes - minutes // 10)
    tens, rest = divmod((count + frames) % (_DAY_MINUTES // 10 * ten_minutes), ten_minutes)
    left_out = dropped * (max(0, rest - dropped) // minute)
    seconds, number = divmod(tens * 600 * base + rest + left_out, base)
    sign = ";" if dropped else ":"
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}{sign}{number:02d}"
