"""16-bit gray PNG and PGM, by default in millimetres; 0 means no depth. Their sidecar in JSON."""

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from depthcli.core.arrays import UInt16Array
from depthcli.core.imageops import row_bands
from depthcli.core.options import one_line
from depthcli.core.types import DepthKind, DepthMap, DepthRange, Frame
from depthcli.errors import InputError, OutputError
from depthcli.io.formats.table import WriterOptions
from depthcli.io.images.png import SIGNATURE, encode_png, read_text
from depthcli.io.images.read import OPENCV_MAX_PIXELS, check
from depthcli.io.media import KEY_PREFIX
from depthcli.io.storage.paths import read_bytes
from depthcli.io.stored import metadata as facts
from depthcli.io.stored.depth import (
    SIDECAR_ENDS,
    DepthReadOptions,
    StoredDepth,
    reciprocal,
    with_sidecar,
)

_GRAY_RANK = 2
_ERROR_STEPS = 10_000.0
_PGM_TEXT = re.compile(rb"^# (%s\w+) (.*)$" % KEY_PREFIX.encode(), re.MULTILINE)
_PGM_HEAD_BYTES = 4096


class Png16Writer(WriterOptions):
    """uint16 gray PNG, or PGM (Netpbm) by the suffix of the file."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write (H, W) uint16; depth beyond the range saturates, with a warning."""
        del frame
        steps, texts, warnings = stored_steps(depth, self, path.suffix[1:])
        if path.suffix.lower() != ".pgm":
            path.write_bytes(encode_png(steps, facts.own_texts(texts)))
            return warnings
        comments = [one_line(f"# {name} {text}") for name, text in facts.own_texts(texts).items()]
        lines = ["P5", *comments, f"{depth.width} {depth.height}", "65535", ""]
        head = "\n".join(lines).encode("ascii", "backslashreplace")
        path.write_bytes(head + steps.astype(">u2").tobytes())
        return warnings


class ErrorWriter(WriterOptions):
    """The expected error of depth in steps of 0.01 % of it; 0 where there is no depth."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write (H, W) uint16."""
        del frame
        if depth.error is None:
            raise OutputError("the error of depth is not known", "leave it out", option="format")
        error = np.where(depth.valid, depth.error, np.float32(np.nan))
        steps, _ = facts.quantized(error, _ERROR_STEPS)
        texts = facts.metadata_texts(depth) | {"kind": facts.ERROR, "scale": f"{_ERROR_STEPS:g}"}
        path.write_bytes(encode_png(steps, facts.own_texts(texts)))
        return ()


class SidecarWriter(WriterOptions):
    """Unit, scale, kind, orientation, model, resize, camera, range and version."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write one JSON object."""
        source = depth.provenance
        range_, ends = DepthRange.of(depth), dict[str, float]()
        if self.is_normalized and range_.min is not None and range_.max is not None:
            ends = dict(zip(SIDECAR_ENDS, self.range_of((range_.min, range_.max)), strict=True))
        has_unit = depth.is_metric and not self.is_normalized
        document = {
            "software": facts.SOFTWARE,
            "kind": depth.kind.value,
            "unit": depth.unit,
            "png16_scale": self.units_per_metre if has_unit else None,
            **({"png16_inverse": True} if self.png_inverse and depth.is_metric else {}),
            **ends,
            "width": depth.width,
            "height": depth.height,
            "orientation": frame.orientation if frame else source.orientation,
            **({"projection": source.projection} if source.projection.is_other else {}),
            **({} if source.time_s is None else {"time_s": source.time_s}),
            **range_._asdict(),
            "network_size_px": source.input_size_px,
            **facts.origin_fields(depth),
            **facts.known_depth_fields(depth),
        }
        path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", "utf-8")
        return ()


def stored_steps(
    depth: DepthMap, options: Png16Writer, suffix: str
) -> tuple[UInt16Array, dict[str, str], tuple[str, ...]]:
    """The integers of a map, (H, W) uint16; texts that say what they mean; and warnings."""
    texts, is_metric = facts.metadata_texts(depth), depth.is_metric
    if not options.is_normalized and is_metric:
        steps, saturated = facts.quantized(depth.values, options.units_per_metre)
        texts |= {
            "scale": f"{options.units_per_metre:g}",
            "unit": facts.step_unit(options.units_per_metre),
        }
        limit_m = facts.UINT16_MAX / options.units_per_metre
        warning = f"{saturated} pixels beyond {limit_m:.6g} m were saturated"
        return steps, texts, (warning,) if saturated else ()
    scale = "normalized"
    if options.png_inverse and is_metric:
        least, most = options.vmin, options.vmax
        if any(end is not None and end <= 0 for end in (least, most)):
            raise OutputError("0 m has no inverse", "give {vmin} and {vmax} above 0")
        scale, depth = "inverse", replace(depth, values=reciprocal(depth.values))
        options = replace(options, vmin=most and 1 / most, vmax=least and 1 / least)
    steps, (low, high), saturated = stretched(depth, options)
    texts |= {"scale": scale, "range": f"{low:.9g} {high:.9g}"}
    warning = f"{depth.kind} depth has no unit; {suffix} is normalized"
    if options.png_inverse and depth.kind is DepthKind.RELATIVE:
        warning += ", and far is white, as it has no inverse"
    warnings = (warning,) * (not (is_metric or options.png_normalize))
    if saturated:
        ends = (1 / high, 1 / low) if scale == "inverse" else (low, high)
        beyond = f"outside {ends[0]:.6g} to {ends[1]:.6g}{' m' if is_metric else ''}"
        warnings += (f"{saturated} pixels {beyond} were saturated",)
    return steps, texts, warnings


def stretched(
    depth: DepthMap, options: WriterOptions
) -> tuple[UInt16Array, tuple[float, float], int]:
    """Depth as 1-65535, 0 for none, (H, W) uint16, of its own range where no other is stated.

    Also returns the values that 1 and 65535 stand for, and the number of pixels beyond.
    """
    values, valid = depth.values, depth.valid
    if not valid.any():
        return np.zeros(values.shape, np.uint16), (0.0, 0.0), 0
    least = float(values.min(where=valid, initial=np.inf))
    most = float(values.max(where=valid, initial=-np.inf))
    low, high = options.range_of((least, most))
    half_step, saturated = (high - low) / (facts.UINT16_MAX - 1) / 2, 0
    steps = np.empty(values.shape, np.uint16)
    for rows in row_bands(values.shape[1], values.shape[0]):  # float64 of a whole map is large
        band = values[rows].astype(np.float64)
        steps[rows] = facts.normalized(band, valid[rows], low, high)
        beyond = (band < low - half_step) | (band > high + half_step)
        saturated += int(np.count_nonzero(valid[rows] & beyond))
    return steps, (low, high), saturated


def read(path: Path, options: DepthReadOptions) -> StoredDepth:
    """Depth of a 16-bit gray PNG or PGM of any program."""
    data = read_bytes(path)
    steps = check(data, str(path), OPENCV_MAX_PIXELS).decode().pixels
    if steps.dtype != np.uint16 or steps.ndim != _GRAY_RANK:
        raise InputError(
            f"{path} is not 16-bit gray, so it holds no depth; it may be a preview or an image"
        )
    return StoredDepth.of(path, steps, _own_texts(data), options)


def read_metadata(path: Path) -> Mapping[str, str]:
    """Metadata of a PNG and its sidecar, texts by name; the pixels are not decoded."""
    data = read_bytes(path)
    header = check(data, str(path), OPENCV_MAX_PIXELS).header
    return with_sidecar(path, _own_texts(data), (header.width, header.height))[0]


def _own_texts(data: bytes) -> dict[str, str]:
    if data.startswith(SIGNATURE):
        return facts.own_metadata(read_text(data))
    comments = _PGM_TEXT.findall(data[:_PGM_HEAD_BYTES])
    texts = {name.decode(): text.decode("ascii", "replace") for name, text in comments}
    return facts.own_metadata(texts)
