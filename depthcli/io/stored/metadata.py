"""Metadata of depth in files and reports, by the same names everywhere, and scales of numbers."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from depthcli._version import __version__
from depthcli.core import camera, imageops, options, types
from depthcli.errors import Message, UsageError
from depthcli.io.media import KEY_PREFIX

SOFTWARE = f"depthcli {__version__}"
_Value: TypeAlias = str | float | tuple[float, float]
_SOURCE_TEXTS = {
    camera.CameraSource.OPTION: "given",
    camera.CameraSource.EXIF: "from EXIF",
    camera.CameraSource.CARD: "assumed, from the model's card",
    camera.CameraSource.MODEL: "estimated by the model",
}
LEAST, _MOST = 1e-9, 1e12  #: positive number, and number, in a file
_ORIENTATIONS = frozenset("12345678")


ORIGIN_FIELDS = (
    *("model", "model_sha256", "focal_px", "centre_px", "camera_source"),
    *("pixel_aspect", "camera"),
)
"""Names of the fields about model and camera; formats without metadata have them in a sidecar."""


def origin_fields(depth: types.DepthMap) -> dict[str, _Value | None]:
    """The facts about model and camera, ``ORIGIN_FIELDS``, by name; None where one is unknown."""
    source = depth.provenance
    origin = {name: getattr(source, name) for name in ORIGIN_FIELDS[:-1]}
    return {**origin, "camera": camera_text(depth)}


def known_depth_fields(depth: types.DepthMap) -> dict[str, dict[str, Any] | None]:
    """Fit to known points for JSON, None without one; with a calibrated camera, also its scale."""
    source = depth.provenance
    fit, scale = source.anchor_fit, source.camera_scale
    record = {"anchors": fit and {**fit._asdict(), "residual_m": round(fit.residual_m, 6)}}
    return record if scale is None else {**record, "camera_scale": asdict(scale)}


ERROR = "error"  #: kind of a file, or name of a channel, with the expected error of depth


def metadata_texts(depth: types.DepthMap) -> dict[str, str]:
    """The metadata, the software, a frame's time and the fit to known points as texts by name.

    What is unknown is left out, and the shape of square pixels. The unit of a map without one is
    ``none``.
    """
    source = depth.provenance
    texts = {"kind": depth.kind.value, "unit": depth.unit or "none", "software": SOFTWARE}
    if source.time_s is not None:
        texts["time_s"] = f"{source.time_s:.12g}"
    if source.anchor_fit is not None:
        used, total, residual_m, fit = source.anchor_fit
        texts["anchors"] = f"{used},{total},{residual_m:.6g}{f',{fit}' if fit else ''}"
    if (scale := source.camera_scale) is not None:
        texts["camera_scale"] = f"{scale.name},{scale.scale:.6g},{scale.shift_m:.6g}"
    origin = origin_fields(depth)
    if source.pixel_aspect == 1:
        del origin["pixel_aspect"]
    if source.projection.is_other:
        texts["projection"] = source.projection.value
    if source.focal_px is not None or source.centre_px is not None:
        texts["camera_size_px"] = f"{depth.width},{depth.height}"
    return texts | {name: _value_text(value) for name, value in origin.items() if value}


def _value_text(value: _Value) -> str:
    if isinstance(value, tuple):
        return ",".join(f"{part:.9g}" for part in value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def camera_text(depth: types.DepthMap) -> str | None:
    """The camera of a map's metres, its source, and the fit to known points; None if unknown."""
    source = depth.provenance
    fitted = _fit_text(source.anchor_fit) if source.anchor_fit else ""
    if source.projection.is_other:
        return f"{source.projection.value}, metres along the ray{fitted}"
    if source.focal_px is None:
        return f"unknown{fitted}" if fitted else None
    hfov = f"hfov {camera.hfov_deg(source.focal_px, depth.width):.1f}°"
    if source.camera_scale is not None:
        fitted = f"; calibrated as {source.camera_scale.name}{fitted}"
    origin = "" if source.camera_source is None else f" ({_SOURCE_TEXTS[source.camera_source]})"
    return f"{hfov}{origin}{fitted}"


def _fit_text(fit: types.AnchorFit) -> str:
    of_all = "" if fit.used == fit.given else f"{fit.used} of "
    error = f", median error {fit.residual_m:.3f} m" if fit.given > 1 else ""
    by = " by a network" if fit.fit is options.DepthFit.NETWORK else ""
    return f"; depth fitted{by} to {of_all}{fit.given} anchor{'s'[: fit.given - 1]}{error}"


_UNITS = {1: "m", 100: "cm", options.MILLIMETRES: "mm"}


def step_unit(scale: float) -> str:
    """Unit of depth in a file: ``mm`` for 1000 units per metre."""
    return _UNITS.get(scale, f"1/{scale:g} m")


def own_metadata(texts: Mapping[str, str]) -> dict[str, str]:
    """The metadata among the texts of a PNG or EXR, by name; empty if another program wrote it."""
    return {k.removeprefix(KEY_PREFIX): v for k, v in texts.items() if k.startswith(KEY_PREFIX)}


def own_texts(metadata: Mapping[str, str]) -> dict[str, str]:
    """The texts of a PNG or EXR that state metadata; :func:`own_metadata` reads them."""
    return {f"{KEY_PREFIX}{name}": text for name, text in metadata.items()}


_CAMERA_TEXTS = ("camera", "camera_source", "focal_px", "centre_px")


def of_size(
    metadata: Mapping[str, str], size_px: tuple[int, int], name: str
) -> tuple[dict[str, str], tuple[Message, ...]]:
    """Metadata whose camera is that of a map of this size, which another program may have resized.

    If one factor explains both sides, focal length and principal point are scaled by it. Of a crop,
    nothing of the camera is left but ``camera_size_px``. A warning names the file.
    """
    texts, own = dict(metadata), _size_px(metadata.get("camera_size_px"))
    width, height = size_px
    if own is None or own == size_px:
        return texts, ()
    now, then = f"{width}×{height}", f"{own[0]}×{own[1]}"
    if abs(width * own[1] - height * own[0]) < max(own):
        scale = width / own[0]
        if focal_px := number(metadata.get("focal_px"), LEAST):
            texts["focal_px"] = _value_text(focal_px * scale)
        if centre := _pair(metadata.get("centre_px")):
            x, y = ((along + 0.5) * scale - 0.5 for along in centre)
            texts["centre_px"] = _value_text((x, y))
        texts["camera_size_px"] = f"{width},{height}"
        resized = f"{name} was resized from {then} to {now} pixels, and its focal length is scaled"
        return texts, (Message(resized, "if it was cropped instead, give {focal_px}"),)
    for one in _CAMERA_TEXTS:
        texts.pop(one, None)
    problem = (
        f"{name} has {now} pixels, and its focal length is for {then}: it was cropped or resized"
    )
    return texts, (Message(problem, "give {focal_px} in its pixels for a point cloud"),)


def provenance_of(metadata: Mapping[str, str]) -> types.Provenance:
    """The provenance of a map, as far as its metadata state it."""
    orientation, source = metadata.get("orientation"), metadata.get("camera_source")
    value = metadata.get("projection")
    return types.Provenance(
        model=metadata.get("model"),
        model_sha256=metadata.get("model_sha256"),
        input_size_px=_size_px(metadata.get("network_size_px")),
        focal_px=number(metadata.get("focal_px"), LEAST),
        orientation=int(orientation) if orientation in _ORIENTATIONS else None,
        camera_source=camera.CameraSource(source) if source in tuple(camera.CameraSource) else None,
        centre_px=_pair(metadata.get("centre_px")),
        time_s=number(metadata.get("time_s")),
        anchor_fit=_anchor_fit(metadata.get("anchors")),
        pixel_aspect=number(metadata.get("pixel_aspect"), *types.PIXEL_ASPECTS) or 1.0,
        projection=options.Projection(value)
        if value in tuple(options.Projection)
        else options.Projection.PINHOLE,
        is_cropped="camera_size_px" in metadata and not {"focal_px", "centre_px"} & set(metadata),
    )


def number(text: str | None, least: float = -_MOST, most: float = _MOST) -> float | None:
    """A number of a range from an untrusted file; None for anything else."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if least <= value <= most else None


def _number_list(text: str | None) -> list[float | None]:
    return [number(part) for part in (text or "").split(",")]


def _pair(text: str | None) -> tuple[float, float] | None:
    match _number_list(text):
        case [float(x), float(y)]:
            return x, y
    return None


def _size_px(text: str | None) -> tuple[int, int] | None:
    pair = _pair(text)
    return (int(pair[0]), int(pair[1])) if pair and min(pair) >= 1 else None


def _anchor_fit(text: str | None) -> types.AnchorFit | None:
    *_, last = (text or "").split(",")
    fit = options.DepthFit(last) if last in tuple(options.DepthFit) else None
    match _number_list(text and text.removesuffix(f",{fit}")):
        case [float(used), float(given), float(residual_m)] if (
            1 <= used <= given and residual_m >= 0
        ):
            return types.AnchorFit(int(used), int(given), residual_m, fit)
    return None


UINT16_MAX = 65535
NORMALIZED = ("normalized", "inverse")  #: scales of integers that span the range of (1/)depth


class DepthScale(NamedTuple):
    """The scale of the numbers in a depth file."""

    units_per_metre: float  #: 1000 for millimetres
    source: Literal["file", "option", "assumed"]  #: who states it

    @property
    def text(self) -> str:
        """Unit and source, for tables: ``mm, assumed``."""
        source = {"file": "stated", "option": "given", "assumed": "assumed"}[self.source]
        return f"{step_unit(self.units_per_metre)}, {source}"


def depth_scale(
    metadata: Mapping[str, str],
    option: float | None,
    unstated: float | None = None,
    *,
    is_integer: bool = True,
    has_unit: bool = True,
) -> DepthScale | None:
    """Scale of the numbers in a file; None if they are normalized or have no unit.

    It is that of the option, else what the metadata state, else ``unstated``, else millimetres in
    integers and metres in floats, if there is a unit even if none is stated.
    """
    if option is None and metadata.get("scale") in NORMALIZED:
        return None
    of_file = number(metadata.get("scale"), LEAST)
    if of_file is None and not is_integer and has_unit and "software" in metadata:
        of_file = 1.0  # depthcli wrote it
    if option is None and of_file is not None:
        return DepthScale(of_file, "file")
    scale = unstated if option is None else option
    if scale is not None:
        if not 0 < scale < math.inf:
            raise UsageError(f"a scale of {scale:g} units per metre is not a number above 0")
        return DepthScale(scale, "option")
    return DepthScale(options.MILLIMETRES if is_integer else 1.0, "assumed") if has_unit else None


def quantized(values: types.Float32Array, scale: float) -> tuple[types.UInt16Array, int]:
    """Metres, (H, W), as 16-bit integers of ``scale`` units per metre, rounded to nearest.

    They are 0 where there is no depth, 1 to 65535 elsewhere; with the number of pixels beyond.
    """
    height, width = values.shape
    steps = np.empty((height, width), np.uint16)
    saturated = 0
    for rows in imageops.row_bands(width, height):
        band, valid = values[rows] * np.float32(scale), types.has_depth(values[rows])
        np.rint(band, out=band)
        saturated += int(np.count_nonzero(valid & (band >= UINT16_MAX)))
        np.clip(band, 1, UINT16_MAX, out=band)
        band[~valid] = 0
        steps[rows] = band
    return steps, saturated


def dequantized(steps: npt.NDArray[np.generic], scale: float) -> types.Float32Array:
    """Metres of integers of ``scale`` units per metre: (H, W) in, float32 out, NaN where 0."""
    values = steps.astype(np.float32) / np.float32(scale)
    return np.where(steps == 0, np.float32(np.nan), values)


def normalized(
    values: types.FloatArray, valid: types.BoolArray, low: float, high: float
) -> types.UInt16Array:
    """Values from ``low`` to ``high`` as 1-65535, clamped; 0 where they are not known."""
    share = (np.where(valid, values, low) - low) / ((high - low) or 1.0)
    steps = np.rint(1 + np.clip(share, 0, 1) * (UINT16_MAX - 1))
    return np.where(valid, steps, 0).astype(np.uint16)


def denormalized(steps: npt.NDArray[np.generic], low: float, high: float) -> types.Float32Array:
    """Values from ``low`` to ``high`` of 1-65535: (H, W) in, float32 out, NaN where they are 0."""
    share = (steps.astype(np.float64) - 1) / (UINT16_MAX - 1)
    values = (low + share * (high - low)).astype(np.float32)
    return np.where(steps == 0, np.float32(np.nan), values)
