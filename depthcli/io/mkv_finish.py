"""Exact times and labels for Matroska files that OpenCV wrote.

OpenCV rounds a frame rate to three decimals and asks for constant frames. The times stand in the
file in fields of fixed width, so they are corrected in place (RFC 9559, Matroska).
"""

from __future__ import annotations

import hashlib
import struct
from typing import TYPE_CHECKING

from depthcli.io.ebml import content, element_at, elements, file_size, packed, sized
from depthcli.io.mkv_identity import identify

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from fractions import Fraction
    from pathlib import Path
    from typing import BinaryIO

    from depthcli.io.ebml import Element

_SEGMENT, _INFO, _TRACKS, _CLUSTER = 0x18538067, 0x1549A966, 0x1654AE6B, 0x1F43B675
_CUES, _TAGS = 0x1C53BB6B, 0x1254C367
_DURATION, _TRACK, _DEFAULT_DURATION = 0x4489, 0xAE, 0x23E383
_TIMESTAMP, _SIMPLE_BLOCK, _BLOCK_GROUP, _BLOCK = 0xE7, 0xA3, 0xA0, 0xA1
_CUE_POINT, _CUE_TIME = 0xBB, 0xB3
_TAG, _TARGETS, _SIMPLE_TAG, _TAG_NAME, _TAG_STRING = 0x7373, 0x63C0, 0x67C8, 0x45A3, 0x4487
_NANOSECONDS = 1_000_000_000
_MILLISECONDS = 1000
_LONGEST_STEP_MS = 32767  # a block's time is a signed 16-bit distance from its cluster's
_PREFIX = "DEPTHCLI_"
OPENCV_RATE = 0.01
"""Frames a second for OpenCV's writer, whatever the true rate: at 100 s a frame, FFmpeg begins a
cluster for each and leaves room for large times, so that every true time fits where one stood."""


def finish_mkv(
    path: Path, rate: Fraction, times_s: Sequence[float], labels: Mapping[str, str]
) -> None:
    """Give a file its frame rate, the time of every frame, and labels.

    Args:
        path: one video track, as OpenCV closed it.
        rate: frames a second; readers find it again from the duration of a frame in nanoseconds.
        times_s: of each frame from the first, in seconds; stored to the millisecond.
        labels: name -> text, stored as tags.

    Raises:
        ValueError: the file is incomplete, has another number of frames, or a time does not fit.
        OSError: it cannot be read or written.
    """
    duration_s = float(times_s[-1] + 1 / rate)
    times_ms = [round(time * _MILLISECONDS) for time in times_s]
    with path.open("r+b") as file:
        segment = _segment(file)
        moved: dict[int, int] = {}
        written = 0
        for part in elements(file, segment.start, segment.end):
            if part.id == _INFO:
                _set_duration(file, part, duration_s * _MILLISECONDS)
            elif part.id == _TRACKS:
                _set_frame_duration(file, part, round(_NANOSECONDS / rate))
            elif part.id == _CLUSTER:
                written += _retime(file, part, times_ms[written:], moved)
            elif part.id == _CUES:
                _move_cues(file, part, moved)
        if written != len(times_ms):
            msg = f"{written} of {len(times_ms)} frames are in the file"
            raise ValueError(msg)
        identify(file, segment, _uid(times_ms, labels), duration_s)
        _append_tags(file, segment, labels)


def _uid(times_ms: Sequence[int], labels: Mapping[str, str]) -> bytes:
    """16 bytes that name a file, the same whenever it is made."""
    return hashlib.sha256(repr((times_ms, sorted(labels.items()))).encode()).digest()[:16]


def mkv_labels(path: Path) -> dict[str, str]:
    """The labels of a file that :func:`finish_mkv` finished; empty for other files.

    Raises:
        OSError: it cannot be read.
    """
    labels: dict[str, str] = {}
    try:
        with path.open("rb") as file:
            segment = _segment(file)
            for tags in _within(file, segment, _TAGS):
                for tag in _within(file, tags, _TAG):
                    labels |= dict(_label(file, e) for e in _within(file, tag, _SIMPLE_TAG))
    except ValueError:
        pass  # a file cut short: the labels up to there
    return {k.removeprefix(_PREFIX).lower(): v for k, v in labels.items() if k.startswith(_PREFIX)}


def _segment(file: BinaryIO) -> Element:
    """The element that holds everything after the header."""
    header = element_at(file, 0)
    segment = element_at(file, header.end)
    if segment.id != _SEGMENT or segment.end > file_size(file):
        msg = "the file is no whole Matroska file"
        raise ValueError(msg)
    return segment


def _within(file: BinaryIO, parent: Element, number: int) -> Iterator[Element]:
    return (e for e in elements(file, parent.start, parent.end) if e.id == number)


def _put(file: BinaryIO, element: Element, number: int) -> None:
    """Replace an unsigned number by another in the same bytes."""
    try:
        data = number.to_bytes(element.end - element.start)
    except OverflowError as error:
        msg = f"{number} does not fit into element {element.id:X}"
        raise ValueError(msg) from error
    file.seek(element.start)
    file.write(data)


def _set_duration(file: BinaryIO, info: Element, milliseconds: float) -> None:
    for element in _within(file, info, _DURATION):
        file.seek(element.start)
        file.write(struct.pack(">d" if element.size == 8 else ">f", milliseconds))  # noqa: PLR2004


def _set_frame_duration(file: BinaryIO, tracks: Element, nanoseconds: int) -> None:
    for track in _within(file, tracks, _TRACK):
        for element in _within(file, track, _DEFAULT_DURATION):
            _put(file, element, nanoseconds)


def _retime(
    file: BinaryIO, cluster: Element, times_ms: Sequence[int], moved: dict[int, int]
) -> int:
    """Set the times of a cluster and of its frames; remember which time became which.

    Returns:
        Frames in it.
    """
    old_base = 0
    count = 0
    for part in list(elements(file, cluster.start, cluster.end)):
        if part.id == _TIMESTAMP:
            old_base = int.from_bytes(content(file, part))
            _put(file, part, times_ms[0] if times_ms else 0)
        blocks = list(_within(file, part, _BLOCK)) if part.id == _BLOCK_GROUP else [part]
        for block in blocks:
            if block.id not in {_SIMPLE_BLOCK, _BLOCK} or count >= len(times_ms):
                continue
            file.seek(block.start + 1)  # behind the track's number
            old = old_base + struct.unpack(">h", file.read(2))[0]
            step = times_ms[count] - times_ms[0]
            if step > _LONGEST_STEP_MS:
                msg = f"a frame {step} ms after its cluster does not fit"
                raise ValueError(msg)
            file.seek(block.start + 1)
            file.write(struct.pack(">h", step))
            moved[old] = times_ms[0] + step
            count += 1
    return count


def _move_cues(file: BinaryIO, cues: Element, moved: Mapping[int, int]) -> None:
    for point in _within(file, cues, _CUE_POINT):
        for element in _within(file, point, _CUE_TIME):
            old = int.from_bytes(content(file, element))
            _put(file, element, moved.get(old, old))


def _append_tags(file: BinaryIO, segment: Element, labels: Mapping[str, str]) -> None:
    tags = b"".join(
        packed(
            _SIMPLE_TAG,
            packed(_TAG_NAME, f"{_PREFIX}{name.upper()}".encode())
            + packed(_TAG_STRING, text.encode()),
        )
        for name, text in labels.items()
    )
    body = packed(_TAGS, packed(_TAG, packed(_TARGETS, b"") + tags))
    if segment.start - segment.size_at != len(sized(0)) or file_size(file) != segment.end:
        msg = "the file does not end where it says"
        raise ValueError(msg)
    file.write(body)
    file.seek(segment.size_at)
    file.write(sized(segment.end - segment.start + len(body)))


def _label(file: BinaryIO, tag: Element) -> tuple[str, str]:
    parts = {e.id: content(file, e) for e in elements(file, tag.start, tag.end)}
    name, text = (parts.get(n, b"").decode("utf-8", "replace") for n in (_TAG_NAME, _TAG_STRING))
    return name, text
