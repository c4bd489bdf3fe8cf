"""OpenEXR: floating-point depth and normals, for compositing."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from depthcli.core.options import one_line
from depthcli.core.surface import surface_of
from depthcli.core.types import AnyArray, DepthMap, Frame, Provenance, Window, Windows
from depthcli.errors import InputError
from depthcli.io.exr import file as exr_file
from depthcli.io.formats import geometry, table
from depthcli.io.stored.depth import DepthReadOptions, StoredDepth
from depthcli.io.stored.metadata import ERROR, metadata_texts, own_metadata, own_texts

_OPENGL = np.array([1, -1, -1], np.float32)
_COLOURS = ("G", "B", "RY", "BY")
_UNREAL = re.compile(r"(?i)WorldDepth|^FinalImage.*Depth")  # of its Movie Render Queue, in cm


class ExrWriter(table.WriterOptions):
    """One channel, ZIP-compressed."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write metres along the camera axis, bit for bit unless ``half``; NaN stays NaN."""
        displayed, stored, windows = _windowed(depth, frame)
        channels, warnings = self._channels(displayed, stored, windows)
        source = depth.provenance if depth.provenance != Provenance() else frame or Provenance()
        exr_file.write_exr(
            path,
            channels,
            own_texts(metadata_texts(displayed)),
            frame.rate if frame else None,
            pixel_aspect=source.pixel_aspect,
            windows=windows,
            time_code=frame.time_code if frame else None,
        )
        return warnings

    def _channels(
        self, displayed: DepthMap, stored: DepthMap, windows: tuple[Window, Window] | None
    ) -> tuple[dict[str, AnyArray], tuple[str, ...]]:
        """The channels of a map, which are those of its data window, and warnings."""
        values: AnyArray = np.ascontiguousarray(stored.values)
        if self.half:
            with np.errstate(over="ignore"):
                values = values.astype(np.float16)
        lost = np.count_nonzero(np.isinf(values) & np.isfinite(stored.values)) if self.half else 0
        warnings = (f"{lost} pixels are beyond half floats and became infinite",) if lost else ()
        channels: dict[str, AnyArray] = {self.exr_channel: values}
        if stored.error is not None:
            channels[ERROR] = np.ascontiguousarray(stored.error.astype(values.dtype))
        return channels, warnings


class NormalsExrWriter(ExrWriter):
    """Unit normals in N.X, N.Y and N.Z: x to the right, y up, z towards the camera; 0 without."""

    def _channels(
        self, displayed: DepthMap, stored: DepthMap, windows: tuple[Window, Window] | None
    ) -> tuple[dict[str, AnyArray], tuple[str, ...]]:
        (focal_px, warnings), source = geometry.camera_of(displayed), displayed.provenance
        x, y = source.centre_px or ((displayed.width - 1) / 2, (displayed.height - 1) / 2)
        if windows is not None:
            data, display = windows
            x, y = x + display.left - data.left, y + display.top - data.top
        depth = replace(stored, provenance=replace(source, centre_px=(x, y)))
        normals = np.nan_to_num(surface_of(depth, focal_px).normals()) * _OPENGL
        planes = np.moveaxis(normals.astype(np.float16 if self.half else np.float32), -1, 0).copy()
        return {f"N.{axis}": planes[i] for i, axis in enumerate("XYZ")}, warnings


def _windowed(
    depth: DepthMap, frame: Frame | None
) -> tuple[DepthMap, DepthMap, tuple[Window, Window] | None]:
    """The map in the display window, which its camera is of; in the data window; both windows."""
    windows = frame.windows if frame else None
    if windows is None:
        return depth, depth, None
    display = windows.display
    # A file has to have a pixel.
    corner = Window(display.left, display.top, display.left + 1, display.top + 1)
    data = corner if windows.valid.is_empty else windows.valid
    displayed, stored = (depth.over(windows.pixels, each) for each in (display, data))
    return displayed, stored, (data, display)


def read(path: Path, options: DepthReadOptions) -> StoredDepth:
    """Depth of an EXR of any program, over its data window."""
    channels = exr_file.read_exr_channels(path)
    name, doubt = exr_file.choose_depth(str(path), channels, options.layer)
    if name is None or _is_coloured(name, channels):
        raise InputError(f"{path} holds no depth; it has {one_line(', '.join(channels))}")
    stored, part = channels[name], channels[name].part
    texts = own_metadata(part.texts)
    if part.pixel_aspect != 1:
        texts["pixel_aspect"] = str(part.pixel_aspect)
    if _UNREAL.search(name):
        texts["scale"] = "100"
    frame = Frame(
        np.zeros((1, 1), np.uint8),
        rate=part.rate,
        pixel_aspect=part.pixel_aspect,
        windows=Windows(part.data, part.data, part.display),
        time_code=part.time_code,
        view=part.view,
    )
    result = StoredDepth.of(path, stored.over(part.data), texts, options.for_name(name), frame)
    warnings = (*result.warnings, doubt) if doubt else result.warnings
    if ERROR in channels and "software" in texts:
        error = np.asarray(channels[ERROR].over(part.data), np.float32)
        result = replace(result, depth=replace(result.depth, error=error))
    return replace(result, channel=name, warnings=warnings)


def _is_coloured(name: str, channels: Mapping[str, exr_file.StoredChannel]) -> bool:
    """Whether a channel belongs to a colour image; gray may be stored as three equal colours."""
    layer = exr_file.layer_of(name)
    names = [] if name == layer + "Z" else [layer + colour for colour in _COLOURS]
    first, *others = (
        channels[each].over(channels[each].part.display)
        for each in (name, *names)
        if each in channels
    )
    return not all(np.array_equal(first, other, equal_nan=True) for other in others)
