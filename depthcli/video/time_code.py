"""SMPTE time codes (ST 12-1) of videos: in their headers, and counted by frames.

Above 30 frames a second, ST 12-1 and EXR number pairs of frames, whose second one has a flag; the
headers of videos number all frames.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fractions import Fraction

    from av.container import InputContainer
    from av.video.stream import VideoStream

    from depthcli.video.frames import Timing


TimeCode = tuple[int, ...]
"""Hours, minutes, seconds, frame or pair, and flags, as a ``Frame`` has it."""
_TEXT = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d\d)", re.ASCII)
_KEY = "timecode"
_FRAME, _SECOND_OF_PAIR = 3, 6  # places of the numbers
_FURTHER = (0,) * 13  # flags and binary groups, which containers do not state
_DAY_MINUTES = 24 * 60
_MOST_FPS = 60
_MOST_FPS_UNPAIRED = 30
_TOLERANCE = 0.002  # 30000/1001 frames a second are counted as 30


def header_time_code(
    container: InputContainer, stream: VideoStream, rate: Fraction
) -> TimeCode | None:
    """The time code of a video's first frame, as its file states it; None if it does not.

    ``rate`` is frames a second.
    """
    tables = (stream.metadata, container.metadata, *(other.metadata for other in container.streams))
    texts = (text for table in tables for key, text in table.items() if key.lower() == _KEY)
    return next(filter(None, (parse_time_code(text, rate) for text in texts)), None)


def parse_time_code(text: str, rate: Fraction) -> TimeCode | None:
    """The time code that :func:`time_code_text` writes; None for any other text."""
    match = _TEXT.fullmatch(text)
    if match is None:
        return None
    hours, minutes, seconds, frame = (int(match[i]) for i in (1, 2, 3, 5))
    return _with_frame((hours, minutes, seconds, 0, int(match[4] != ":"), *_FURTHER), frame, rate)


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
    hours, minutes, seconds, _, is_drop = start[:5]
    number, base = _frame_of(start, rate), round(rate)
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
    later = seconds // 3600, seconds // 60 % 60, seconds % 60
    return _with_frame((*later, *start[_FRAME:]), number, rate)


def time_code_text(time_code: TimeCode, rate: Fraction) -> str:
    """``01:02:03:04``, as headers of videos have it; with ``;`` if it is a drop-frame time code.

    ``rate`` is frames a second of the frames that it numbers.
    """
    hours, minutes, seconds, _, is_drop = time_code[:5]
    frame = _frame_of(time_code, rate)
    return f"{hours:02d}:{minutes:02d}:{seconds:02d}{':;'[is_drop]}{frame:02d}"


def time_code_label(first: TimeCode | None, timing: Timing) -> dict[str, str]:
    """Metadata from which FFmpeg writes the time code of a file's first frame; empty for none."""
    if first is None or not timing.has_all_frames:
        return {}
    counted = time_code_after(first, 0, timing.rate)
    return {} if counted is None else {_KEY: time_code_text(counted, timing.rate)}


def _frame_of(time_code: TimeCode, rate: Fraction) -> int:
    """The number of the frame within its second."""
    number = time_code[_FRAME]
    is_paired = round(rate) > _MOST_FPS_UNPAIRED
    return 2 * number + time_code[_SECOND_OF_PAIR] if is_paired else number


def _with_frame(time_code: TimeCode, number: int, rate: Fraction) -> TimeCode:
    """A time code with another number of the frame within its second."""
    if round(rate) <= _MOST_FPS_UNPAIRED:
        return *time_code[:_FRAME], number, *time_code[_FRAME + 1 :]
    flags = time_code[_FRAME + 1 : _SECOND_OF_PAIR]
    pair, second = divmod(number, 2)
    return *time_code[:_FRAME], pair, *flags, second, *time_code[_SECOND_OF_PAIR + 1 :]
