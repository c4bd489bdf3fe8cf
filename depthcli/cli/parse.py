"""Parsing cameras, pixels and points of known depth."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from fractions import Fraction
from typing import Any

from depthcli.cli.checks import given_options, is_given
from depthcli.core.camera import DEPTH_M, Anchor, Intrinsics
from depthcli.core.options import AUTO_TILE, Colormap, Detail, Near, ReadOptions, Upsampling
from depthcli.core.text import short_repr
from depthcli.errors import InputError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.depth.anchors import AnchorFiles
from depthcli.io.formats.table import WriterOptions
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.paths import RemotePath, path_of, safe_name
from depthcli.video.container import single_picture_advice
from depthcli.video.formats import PREVIEW_CODECS, Codec, PreviewCodec, VideoFormat
from depthcli.video.frames import Point, Span, exact_rate
from depthcli.video.source import is_sequence

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


def choose_anchors(
    points: Sequence[str] | None,
    path: str | None,
    scale: float | None,
    *,
    is_folder: bool = False,
) -> AnchorFiles | tuple[Anchor, ...]:
    """The files of ``--anchors``, or the points of ``--anchor``.

    Args:
        points: the points of ``--anchor``.
        path: the file, or a folder.
        scale: units per metre of the files.
        is_folder: whether it has to be a folder with a file for each picture.

    Raises:
        UsageError: the options contradict each other, or the path is a file in place of a folder.
    """
    check_anchors(points, path, scale)
    if path is None:
        return tuple(map(parse_anchor, points or ()))
    place = path_of(path)
    if is_folder and not isinstance(place, RemotePath) and not place.is_dir():
        raise UsageError(
            f"--anchors {place} is not a folder; for 'batch', name one with a file for each picture"
        )
    if not is_folder and not isinstance(place, RemotePath) and place.is_dir():
        raise UsageError(f"--anchors {place} is a folder; name a file, or use 'depthcli batch'")
    return AnchorFiles(path, scale)


def check_anchors(points: Sequence[str] | None, path: str | None, scale: float | None) -> None:
    """Refuse options of :func:`choose_anchors` that do not fit together.

    Raises:
        UsageError: there are such options.
    """
    for point in points or ():
        parse_anchor(point)
    if points and path is not None:
        raise UsageError("give --anchor or --anchors, not both")
    if path is None and scale is not None:
        raise UsageError("--anchors-scale is for --anchors; give both or neither")


_WIDTH = r"0*[1-9][0-9]{0,8}"


def choose_detail(upsampling: Upsampling, tile: str | None) -> Detail:
    """Parse the options; ``tile`` is ``auto`` or a width in pixels.

    Raises:
        UsageError: an option is not of this form.
    """
    return Detail(upsampling, _tile_px(tile))


def _tile_px(text: str | None) -> int | None:
    if text is None:
        return None
    if text == "auto":
        return AUTO_TILE
    if not re.fullmatch(_WIDTH, text):
        raise UsageError(f"--tile is auto or a width in pixels, not {short_repr(text)}")
    return int(text)


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


def choose_codec(
    context: Any,  # noqa: ANN401 - typer's own
    codec: PreviewCodec | None,
    formats: Sequence[VideoFormat],
) -> PreviewCodec | None:
    """The codec to use; None for the default of each container.

    A codec of a profile, which serves several runs, is ignored where a container does not hold it;
    one on the command line is an error later.
    """
    containers = [PREVIEW_CODECS[f".{which}"] for which in formats if which.facts.is_preview]
    if codec is None or is_given(context, "codec"):
        return codec
    return codec if all(Codec(codec) in held for held in containers) else None


def session_loader(
    model: str | None, provider: str, threads: int | None, words: Sequence[str] | None
) -> SessionLoader:
    """The loader for ``--model``, ``--provider``, ``--threads`` and ``--provider-option``.

    Raises:
        UsageError: a provider option is not ``KEY=VALUE``.
    """
    return SessionLoader(model, provider, threads, provider_options(words or ()))


def provider_options(words: Sequence[str]) -> dict[str, str]:
    """Parse provider options ``KEY=VALUE``.

    Raises:
        UsageError: one is not ``KEY=VALUE``.
    """
    pairs = [word.partition("=") for word in words]
    for (key, equals, _), word in zip(pairs, words, strict=True):
        if not (key and equals):
            raise UsageError(
                f"--provider-option {word!r} is not KEY=VALUE; for example device_id=1"
            )
    return {key: value for key, _, value in pairs}


def writer_options(parameters: Mapping[str, Any]) -> WriterOptions:
    """The writers' options from a command's parameters of the same names.

    Those that are missing or None get their defaults.

    Raises:
        UsageError: they contradict each other.
    """
    given = {
        field.name: parameters[field.name]
        for field in fields(WriterOptions)
        if parameters.get(field.name) is not None
    }
    _check_together(given)
    if given.get("near", Near.WARM) != Near.WARM:
        given["colormap"] = Colormap.GRAY
    return WriterOptions(**given)


def _check_together(given: Mapping[str, Any]) -> None:
    """Refuse options that contradict each other."""
    if given.get("png_normalize") and "png_scale" in given:
        raise UsageError("give --png-scale or --png-normalize, not both")
    if "vmin" in given and "vmax" in given:
        if given["vmin"] == given["vmax"]:
            raise UsageError("--vmin and --vmax are equal; give different values")
        if given["vmin"] > given["vmax"]:
            raise UsageError(
                f"--vmin {given['vmin']:g} is above --vmax {given['vmax']:g}; swap them"
            )
    near, colormap = given.get("near"), given.get("colormap")
    if near == Near.WARM and colormap == Colormap.GRAY:
        raise UsageError("gray has no warm end; give --near white or --near black")
    if near in {Near.WHITE, Near.BLACK} and colormap not in {None, Colormap.GRAY}:
        raise UsageError(
            f"--near {near} is for --colormap gray; with {colormap}, near is the warm end"
        )
