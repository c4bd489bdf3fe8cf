"""Facts that a video states about its camera: focal length, stereo layout and projection."""

import mmap
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

from av.container import InputContainer
from av.sidedata.sidedata import Type
from av.video.frame import VideoFrame

from depthcli.core.imageops import PANORAMA, transfer_warning
from depthcli.core.options import Eye, Projection, ReadOptions
from depthcli.errors import Message, UsageError
from depthcli.io.images.heif import boxes

_FOCAL_35MM = "camera.focal_length.35mm_equivalent"
_LENS = re.compile(r"focal|lens", re.IGNORECASE)
_LENGTH = re.compile(r"(\d+(?:\.\d+)?) ?(?:mm)?", re.ASCII)
_LENS_LENGTH = re.compile(r"(\d+(?:\.\d+)?) ?mm", re.ASCII)  # as in "back camera 6.765mm f/1.78"
_TEXT, _FLOAT32, _FLOAT64 = 1, 23, 24  # well-known types of QuickTime's metadata

_SIDE_BY_SIDE, _TOP_BOTTOM = 1, 2
_PACKED = {_SIDE_BY_SIDE: "side by side", _TOP_BOTTOM: "one above the other"}
_INTERLEAVED = range(3, 8)
_LEAST_SHAPE, _TWO_SQUARES = Fraction(5, 4), 2  # width by height of one image, and of two
_PROJECTIONS = {0: Projection.EQUIRECTANGULAR, 1: "cubemap", 2: "tiles", 3: "VR180", 5: "fisheye"}
"""Projections that are not flat, by FFmpeg's numbers."""


def focal_lengths(
    path: Path | None, container: InputContainer
) -> tuple[float | None, float | None]:
    """35-mm equivalent and lens length of a video in mm; of a pipe, what FFmpeg passes on."""
    tags = dict(container.metadata)
    if path is not None and container.format.name.startswith("mov"):
        tags |= _quicktime_tags(path)
    equivalent_mm = lens_mm = None
    for key, text in tags.items():
        if key.lower().endswith(_FOCAL_35MM):
            match = _LENGTH.fullmatch(text.strip())
            equivalent_mm = float(match[1]) or None if match else None
        elif _LENS.search(key) and (match := _LENS_LENGTH.search(text)):
            lens_mm = float(match[1])
    return equivalent_mm, lens_mm


def _quicktime_tags(path: Path) -> dict[str, str]:
    """QuickTime's metadata of the file and its tracks, of which FFmpeg leaves out most."""
    tags: dict[str, str] = {}
    with (
        suppress(OSError, ValueError),  # of a pipe with a name, which has no map
        path.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data,
    ):
        for moov in boxes(data, b"moov", 0, len(data)):
            for place in (moov, *boxes(data, b"trak", *moov)):
                for meta in boxes(data, b"meta", *place):
                    tags = dict(_items(data, *meta)) | tags  # the first of a name counts
    return tags


def _items(data: mmap.mmap, start: int, end: int) -> Iterator[tuple[str, str]]:
    """Names and values of a metadata box."""
    names = []
    for at, stop in boxes(data, b"keys", start, end):
        names += [data[i + 4 : j] for i, j in boxes(data, None, at + 8, stop, head=4)]
    for ilst in boxes(data, b"ilst", start, end):
        for at, stop in boxes(data, None, *ilst):
            number = int.from_bytes(data[at - 4 : at])
            for i, j in boxes(data, b"data", at, stop):
                if 0 < number <= len(names) and i + 8 <= j:
                    name = names[number - 1].decode("utf-8", "replace")
                    yield name, _value(int.from_bytes(data[i : i + 4]), data[i + 8 : j])


def _value(kind: int, data: bytes) -> str:
    if kind == _TEXT:
        return data.decode("utf-8", "replace")
    if (kind, len(data)) in {(_FLOAT32, 4), (_FLOAT64, 8)}:
        return f"{struct.unpack('>f' if kind == _FLOAT32 else '>d', data)[0]:g}"
    return f"{int.from_bytes(data[:8])}"


def camera_warnings(
    frame: VideoFrame, eye: Eye | None, projection: Projection | None
) -> Iterator[str]:
    """Warnings by the first frame, but not about a view or a projection that is given."""
    if warning := transfer_warning(frame.color_trc, "video", "BT.709"):
        yield warning
    if frame.interlaced_frame:
        yield Message(
            "the video is interlaced, and the network sees both fields of a frame at once",
            "deinterlace it first: ffmpeg -i in.mov -vf yadif -c:v ffv1 out.mkv",
        )
    stereo, spherical = _stereo(frame), side_data(frame, Type.SPHERICAL)
    if stereo is None and eye is not None:
        yield "the video states no stereo layout; two views side by side are assumed"
    if stereo is not None and eye is None:
        layout = _PACKED.get(stereo[0], "interleaved")
        yield Message(
            f"each frame holds two views, {layout}, which the network takes for one image",
            "choose one with {eye}",
        )
    sphere = _PROJECTIONS.get(struct.unpack_from("<i", spherical)[0]) if spherical else None
    if sphere is Projection.EQUIRECTANGULAR and projection is None:
        yield PANORAMA
    elif sphere not in {None, projection}:
        yield f"its frames are a panorama ({sphere}), which is taken for another projection"


def view_of(frame: VideoFrame, eye: Eye | None) -> tuple[slice, slice]:
    """Rows and columns of one view of a stereo frame; UsageError if views are interleaved."""
    whole = slice(None)
    if eye is None:
        return whole, whole
    kind, is_inverted = _stereo(frame) or (_SIDE_BY_SIDE, False)
    if kind not in _PACKED:
        raise UsageError("its two views are interleaved", "separate them first", option="eye")
    size = frame.width if kind == _SIDE_BY_SIDE else frame.height
    is_first = (eye is Eye.LEFT) != is_inverted
    half = slice(size // 2) if is_first else slice(size - size // 2, None)
    return (whole, half) if kind == _SIDE_BY_SIDE else (half, whole)


def squeeze_of(frame: VideoFrame, pixel_aspect: Fraction, options: ReadOptions) -> Fraction:
    """Width by height of a pixel of one view, by that of a pixel of the frame.

    Half of the width of each view is kept side by side, half of its height one above the other,
    if the frame has the shape of one image; no container states it.
    """
    kind, shape = (_stereo(frame) or (_SIDE_BY_SIDE,))[0], pixel_aspect * frame.width / frame.height
    is_flat = side_data(frame, Type.SPHERICAL) is None and options.projection is None
    if options.eye is None or shape < _LEAST_SHAPE or not is_flat:
        return Fraction(1)
    if kind == _TOP_BOTTOM:
        return Fraction(1, 2)
    return Fraction(2 if shape < _TWO_SQUARES else 1)


def _stereo(frame: VideoFrame) -> tuple[int, bool] | None:
    """FFmpeg's number of the stereo layout, and whether right is first; None for one view."""
    data = side_data(frame, Type.STEREO3D)
    kind, flags = struct.unpack_from("<2i", data) if data else (0, 0)
    return (kind, bool(flags & 1)) if kind in {*_PACKED, *_INTERLEAVED} else None


def side_data(frame: VideoFrame, kind: Any) -> bytes | None:  # noqa: ANN401 - PyAV's enum
    """Data of one kind beside a frame; None if there is none, or a kind that PyAV does not know."""
    try:
        beside: Any = frame.side_data  # whose type is stated wrongly
        entry = beside.get(kind)
    except ValueError:
        return None
    return None if entry is None else bytes(entry)
