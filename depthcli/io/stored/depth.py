"""Depth that was read from a file: what it, the user, and the JSON file beside it state."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Self

import numpy as np

from depthcli.core import types, validation
from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.options import MILLIMETRES, DepthEncoding
from depthcli.errors import InputError, Message, OutputError, os_errors_as
from depthcli.io.storage.paths import read_regular
from depthcli.io.stored import metadata as facts

_MAX_SIDECAR_BYTES = 2**26  # with a line for each frame of a long video
_NUMBER = re.compile(r"[._\- ]*(\d+)", re.ASCII)
SIDECAR_ENDS = ("png16_min", "png16_max")
_SHARED = (
    *("software", "kind", "orientation", "time_s", "projection", "network_size_px", "anchors"),
    *facts.ORIGIN_FIELDS,
)


def with_sidecar(
    path: Path, own: Mapping[str, str], size_px: tuple[int, int]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """The metadata of a depth file, completed from its sidecar, or from that of its video.

    ``own`` is what the file itself states, ``size_px`` (columns, rows) of its map. One of the
    warnings tells if the sidecar is that of another map.
    """
    own, warnings = facts.of_size(own, size_px, path.name)
    found = _find_sidecar(path)
    if found is None:
        return own, warnings
    sidecar, fields = found
    if not _describes(fields, own, size_px):
        ignored = f"{sidecar} describes another map than {path.name} and is ignored"
        advice = Message(ignored, "remove it, or write it again with {sidecar}")
        return own, (*warnings, advice)
    texts = {name: _text(fields[name]) for name in _SHARED if fields.get(name) is not None}
    if "software" in own:  # without a principal point, the file has that of its middle
        texts.pop("centre_px", None)
    if path.suffix.lower() in {".png", ".pgm"} and "scale" not in own:
        texts |= _png_scale_texts(fields)
    return {**texts, **own}, warnings


def remove_video_sidecar(path: Path) -> None:
    """Remove the sidecar of a video's numbered files, if depthcli wrote it."""
    with os_errors_as(OutputError, f"cannot remove {path}, which describes an earlier video"):
        if "times_s" in _read_sidecar(path):
            path.unlink()


def _find_sidecar(path: Path) -> tuple[Path, dict[str, object]] | None:
    """The sidecar of a file, or with ``time_s`` that of the video of which it is a frame."""
    same_name = path.with_suffix(".json")
    if fields := _read_sidecar(same_name):
        return same_name, fields
    numbers = list(_NUMBER.finditer(same_name.stem))
    for number in reversed(numbers):
        # The frame's number is not always the last one: d.0001.v003.npy. It stands by itself then.
        if number is not numbers[-1] and number.start() and number[0].isdigit():
            continue
        shared = same_name.with_stem(same_name.stem[: number.start()] or "sequence")
        fields = _read_sidecar(shared)
        times_s = fields.pop("times_s", None)
        if isinstance(times_s, dict):
            time_s = times_s.get(str(int(number[1])))
            if time_s is not None:
                return shared, fields | {"time_s": time_s}
    return None


_parsed = lru_cache(maxsize=1)(validation.parsed_json)  # all frames of a long video share one


def _read_sidecar(path: Path) -> dict[str, object]:
    """The content of a sidecar of depthcli; empty if there is none."""
    try:
        fields = _parsed(read_regular(path, _MAX_SIDECAR_BYTES))
    except (OSError, validation.FieldError):
        return {}
    if not (isinstance(fields, dict) and str(fields.get("software")).startswith("depthcli ")):
        return {}
    return dict(fields)


def _describes(
    fields: Mapping[str, object], texts: Mapping[str, str], size_px: tuple[int, int]
) -> bool:
    """Whether a sidecar is that of this map, as far as both state the same facts."""
    # A video's camera is that of its first frame.
    names = ("model_sha256",) if "frames" in fields else ("model_sha256", "camera")
    if any(fields.get(name) != texts[name] for name in names if name in texts):
        return False
    width, height = size_px
    return (fields.get("width", width), fields.get("height", height)) == size_px


def _png_scale_texts(fields: Mapping[str, object]) -> dict[str, str]:
    """Facts that a sidecar states of the integers in the 16-bit PNG beside it."""
    scale = fields.get("png16_scale", fields.get("scale"))  # of an image, of a video
    if scale is not None:
        return {"scale": _text(scale)}
    if "png16_scale" not in fields:
        return {}
    ends = (fields.get(name, fields.get(name.removeprefix("png16_"))) for name in SIDECAR_ENDS)
    low, high = (facts.number(_text(end)) for end in ends)
    if fields.get("png16_inverse") and low and high:
        return {"scale": "inverse", "range": f"{1 / high} {1 / low}"}
    return {"scale": "normalized", "range": f"{low} {high}"}


def _text(value: object) -> str:
    if isinstance(value, dict):  # of the fit to known points
        value = [value.get(name) for name in types.AnchorFit._fields]
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


_NORMALIZED_MAX = 0.999
_INVERSE_NAME = re.compile(r"(?i)disparity|^disp$|inv(erse)?_?depth")
_FARTHEST = 1e12  # no depth is larger, in any unit
_BACKGROUND = 1e9  # least number that stands for the sky: Blender writes 1e10, others up to 3e38
_HALF_BACKGROUND = 65504.0  # largest half float, which Blender and Unreal write for the sky
METRIC = (DepthEncoding.METRIC, DepthEncoding.DISTANCE, DepthEncoding.DISPARITY)
"""Meanings of numbers that have a unit even if none is stated."""


@dataclass(frozen=True, slots=True)
class DepthReadOptions:
    """Statements of the user about a depth file."""

    scale: float | None = None  #: units per metre; None for what the file states
    #: meaning of the numbers in a file that does not state it; None for depth in metres
    kind: DepthEncoding | None = None
    #: units per metre of a file that states none; None for millimetres in integers, else metres
    unstated_scale: float | None = None
    #: of distances along the ray and of disparity; None in it for what the file states
    camera: Intrinsics = UNKNOWN_CAMERA
    baseline_m: float | None = None  #: between the two cameras of disparity
    layer: str | None = None  #: of an EXR; None for the likeliest
    frame: int | None = None  #: of several maps in NPY or NPZ, from 0

    def for_name(self, name: str) -> Self:
        """The options, with inverse depth if a name says so and no kind is stated."""
        is_inverse = self.kind is None and _INVERSE_NAME.search(name)
        return replace(self, kind=DepthEncoding.INVERSE) if is_inverse else self


AS_STATED = DepthReadOptions()  #: no statement of the user: the file's own count


@dataclass(frozen=True, slots=True, eq=False)
class StoredDepth:
    """A depth map that was read from a file."""

    name: str  #: the file
    depth: types.DepthMap  #: the map, of an EXR over its data window
    metadata: Mapping[str, str]  #: metadata of the file and its sidecar, texts by name
    scale: facts.DepthScale | None  #: of the numbers in the file; None if they have no unit
    is_integer: bool  #: whether they are integers
    #: without an image; has windows, shape of pixels, rate and time code of an EXR
    frame: types.Frame
    channel: str | None = None  #: of an EXR, that the depth is read from
    warnings: tuple[str, ...] = ()  #: one line each

    @classmethod
    def of(
        cls,
        path: Path,
        stored: types.AnyArray,
        texts: Mapping[str, str],
        options: DepthReadOptions,
        frame: types.Frame | None = None,
        *,
        has_sidecar: bool = True,
    ) -> Self:
        """Depth of a file from its numbers, its own metadata and the sidecar beside it.

        ``stored`` is (H, W) integers, of which 0 is no depth, or floats; ``texts`` what the file
        states, as of ``metadata_texts``; ``frame`` has the windows of an EXR.
        """
        is_integer, warnings = stored.dtype.kind in "iu", tuple[str, ...]()
        if has_sidecar:
            size_px = frame.display_size_px if frame else stored.shape[::-1]
            texts, warnings = with_sidecar(path, texts, size_px)
        if texts.get("kind") == facts.ERROR:
            raise InputError(f"{path} holds the expected error of depth, not depth")
        kind = DepthEncoding(texts["kind"]) if texts.get("kind") in set(types.DepthKind) else None
        encoding = kind or options.kind or DepthEncoding.METRIC
        scale = facts.depth_scale(
            texts,
            options.scale,
            options.unstated_scale,
            is_integer=is_integer,
            has_unit=encoding in METRIC,
        )
        units = scale.units_per_metre if scale else 1.0
        if options.kind not in {None, encoding}:
            warnings += (f"{path} states {encoding} depth, so it is not read as {options.kind}",)
        if is_integer:
            values = _of_integers(stored, texts, scale, encoding)
        else:
            with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 there is no depth
                values = np.ascontiguousarray(stored, np.float32)
            if encoding in METRIC and "software" not in texts:
                values, found = _without_background(values, str(path))
                warnings += found
            if units != 1:
                values = values / np.float32(units)
        provenance = facts.provenance_of(texts)
        depth = types.DepthMap(values, types.DepthKind.METRIC, provenance)
        if encoding in {DepthEncoding.DISTANCE, DepthEncoding.DISPARITY}:
            depth = _seen_by(depth, encoding, options, frame, str(path))
        elif encoding is DepthEncoding.INVERSE and scale is not None:
            depth = types.DepthMap(reciprocal(values), types.DepthKind.METRIC, provenance)
        elif encoding is not DepthEncoding.METRIC:
            depth = types.DepthMap(values, types.DepthKind(encoding), provenance)
        depth = replace(depth, values=np.where(depth.valid, depth.values, np.float32(np.nan)))
        frame = frame or types.Frame(np.zeros((1, 1), np.uint8))
        return cls(str(path), depth, texts, scale, is_integer, frame, warnings=warnings)

    @property
    def displayed(self) -> types.DepthMap:
        """The map, of an EXR in its display window."""
        return types.displayed_depth(self.depth, self.frame.windows)

    @property
    def unit_text(self) -> str:
        """Unit of the numbers in the file and who states it: ``mm, assumed``."""
        return f"none, {self.depth.kind}" if self.scale is None else self.scale.text

    def warnings_with_scale(self, option: str) -> tuple[str, ...]:
        """The warnings, and one if the unit is assumed, which names the option that states it.

        Of floats, metres are assumed, which is a warning only if they are hardly metres: too large,
        too small, or up to 1 as normalized depth (V-Ray's ZDepth, images of other programs).
        """
        if self.scale is None or self.scale.source != "assumed":
            return self.warnings
        problem = f"{self.name} states no scale, so millimetres are assumed"
        if not self.is_integer:
            _, median_m, most_m = types.DepthRange.of(self.depth)
            fact = "" if median_m is None else types.doubt_of_metres(median_m)
            if most_m is not None and _NORMALIZED_MAX <= most_m <= 1:
                fact = "its numbers end at 1, as those of normalized depth, and not of metres, do"
            if not fact:
                return self.warnings
            problem = f"{self.name} states no unit, and {fact}"
        return (*self.warnings, Message(problem, f"{{{option}}} states another"))


def stated_range(texts: Mapping[str, str]) -> tuple[float, float] | None:
    """The ends of normalized integers, of depth or 1/depth; None if a file states none."""
    try:
        low, high = (float(word) for word in texts.get("range", "").split())
    except ValueError:
        return None
    return (low, high) if -_FARTHEST < low <= high < _FARTHEST else None


def _of_integers(
    steps: types.AnyArray,
    texts: Mapping[str, str],
    scale: facts.DepthScale | None,
    kind: DepthEncoding,
) -> types.Float32Array:
    """Depth of integers, also of ones that span its range, or that of 1/depth."""
    units = scale.units_per_metre if scale else 1.0
    if scale is None and texts.get("scale") in facts.NORMALIZED:
        if ends := stated_range(texts):
            values = facts.denormalized(steps, *ends)
            return reciprocal(values) if texts["scale"] == "inverse" else values
        units = MILLIMETRES
    values = facts.dequantized(steps, units)
    if kind in {DepthEncoding.METRIC, DepthEncoding.DISTANCE} and "software" not in texts:
        values[steps == facts.UINT16_MAX] = np.nan  # unknown, or farther
    return values


def _without_background(
    values: types.Float32Array, name: str
) -> tuple[types.Float32Array, tuple[str, ...]]:
    """Depth without the numbers that stand for the sky, and positive where all is negative.

    Maya and OpenGL have cameras that look along -Z. -1 stands for no depth in many programs.
    """
    warnings: tuple[str, ...] = ()
    sky = np.isfinite(values) & ((values >= _BACKGROUND) | (values == _HALF_BACKGROUND))
    if sky.any():
        warnings = (f"{name}: {sky.sum()} pixels of {values[sky].max():g} are taken as no depth",)
        values = np.where(sky, np.float32(np.nan), values)
    negative = values[np.isfinite(values) & (values < 0) & (values != -1)]
    if negative.size and (values > 0).any():
        ends = f"{negative.min():g} to {negative.max():g}"
        warnings += (f"{name}: {negative.size} pixels from {ends} are taken as no depth",)
    elif negative.size:
        warnings += (f"{name} holds negative depth, along -Z, so its sign is changed",)
        values = -values
    return values, warnings


def _seen_by(
    depth: types.DepthMap,
    encoding: DepthEncoding,
    options: DepthReadOptions,
    frame: types.Frame | None,
    name: str,
) -> types.DepthMap:
    """Depth along the axis of distances along the ray, or of disparity."""
    rows, columns = depth.values.shape
    pixels = display = types.Window(0, 0, columns, rows)
    if frame is not None and frame.windows is not None:
        pixels, display = frame.windows.pixels, frame.windows.display  # that the camera is of
    source = depth.provenance
    focal_px = options.camera.focal_for(display.width, display.height) or source.focal_px
    if focal_px is None:
        raise InputError(f"{name} holds {encoding}, which needs a focal length", "give {focal_px}")
    if encoding is DepthEncoding.DISPARITY:
        if options.baseline_m is None:
            raise InputError(f"{name} holds disparity", "give {baseline} of the two cameras")
        factor = np.float32(focal_px * options.baseline_m)
        return replace(depth, values=reciprocal(depth.values) * factor)
    centre = options.camera.centre_for(display.width, display.height) or source.centre_px
    x, y = centre or ((display.width - 1) / 2, (display.height - 1) / 2)
    aspect = options.camera.pixel_aspect or source.pixel_aspect
    across = (np.arange(columns) + (pixels.left - display.left - x)) / focal_px
    down = (np.arange(rows) + (pixels.top - display.top - y)) / (focal_px * aspect)
    along_ray = np.sqrt(1 + across**2 + down[:, np.newaxis] ** 2)
    return replace(depth, values=(depth.values / along_ray).astype(np.float32))


def reciprocal(values: types.Float32Array) -> types.Float32Array:
    """1/values, NaN where they are not above 0, or infinite; (H, W) float32."""
    result = np.full_like(values, np.nan)
    return np.divide(1, values, out=result, where=np.isfinite(values) & (values > 0))
