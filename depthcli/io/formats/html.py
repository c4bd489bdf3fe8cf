"""A page that shows a map in space: one file that needs no network."""

import base64
import html
import json
import math
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from depthcli.core.surface import Surface
from depthcli.core.types import DepthMap, Frame
from depthcli.io.formats.geometry import SurfaceWriter, camera_of
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.stored.metadata import SOFTWARE

_HERE = Path(__file__).parent
_STEPS = 2**16 - 2
_JPEG_QUALITY = 90
_MAX_POINTS = 640 * 480  # of a page, if no stride is given


class HtmlWriter(SurfaceWriter):
    """Points or a mesh to orbit, with a grid in metres, depth at the pointer, and distances."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the page; without the image, in the colours of a preview."""
        page, warnings = self.render(depth, frame)
        path.write_text(page, "utf-8")
        return warnings

    def render(self, depth: DepthMap, frame: Frame | None = None) -> tuple[str, tuple[str, ...]]:
        """The text of the page, and warnings; a large map is thinned if no stride is given."""
        stride = self.stride or math.ceil(math.sqrt(depth.values.size / _MAX_POINTS))
        surface, warnings = replace(self, stride=stride).surface(depth)
        pixels = PreviewWriter().render(depth) if frame is None else frame.pixels_8bit()
        bgr = np.ascontiguousarray(pixels[::stride, ::stride, ::-1])
        jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
        data = _data(depth, surface, stride) | {"image": _text(jpeg.tobytes())}
        name = frame.path.name if frame and frame.path else "Depth"
        parts = {
            "software": SOFTWARE,
            "title": html.escape(name.encode("utf-8", "replace").decode()),  # of any bytes
            "three": _module("three.module.min.js"),
            "orbit": _module("OrbitControls.js"),
            "script": (_HERE / "page.js").read_text("utf-8"),
            "data": json.dumps(data),
        }
        page = (_HERE / "page.html").read_text("utf-8")
        for part, text in parts.items():
            page = page.replace(f"@{part}@", text)
        return page, warnings


def _data(depth: DepthMap, surface: Surface, stride: int) -> dict[str, Any]:
    """Points and camera for the script: log depth in 16 bits, 0 where there is none."""
    focal_px, _ = camera_of(depth)
    source = depth.provenance
    height, width = surface.depth_m.shape
    nearest_m, farthest_m = (float(end(surface.depth_m)) for end in (np.nanmin, np.nanmax))
    log_step = max(math.log(farthest_m / nearest_m), 1e-6) / (_STEPS - 1)
    steps = np.rint(np.log(surface.depth_m / nearest_m) / log_step) + 1
    links = np.zeros((height, width), np.uint8)
    links[:, :-1] += surface.right
    links[:-1] += 2 * surface.down.astype(np.uint8)
    # High bytes, then low ones, of the differences to the row above; a third of the size.
    changes = np.diff(np.nan_to_num(steps).astype(np.uint16), axis=0, prepend=np.uint16(0))
    planes = (changes >> 8).astype(np.uint8), changes.astype(np.uint8), links
    grid = b"".join(plane.tobytes() for plane in planes)
    percent = None  # of the depth, from 1 to 255
    if depth.error is not None:
        percent = np.rint(np.nan_to_num(depth.error[::stride, ::stride]) * 100).clip(1, 255)
    return {
        "width": width,
        "height": height,
        "stride": stride,
        "size_px": (depth.width, depth.height),
        "focal_px": (focal_px, focal_px * source.pixel_aspect),
        "centre_px": source.centre_px or ((depth.width - 1) / 2, (depth.height - 1) / 2),
        "is_panorama": source.projection.is_other,
        "nearest_m": nearest_m,
        "log_step": log_step,
        "grid": _text(zlib.compress(grid, 9)),
        "error": None
        if percent is None
        else _text(zlib.compress(percent.astype(np.uint8).tobytes(), 9)),
    }


def _module(name: str) -> str:
    """A script as the address of a module, so that pages opened from a file can import it."""
    return f"data:text/javascript;base64,{_text((_HERE / 'three' / name).read_bytes())}"


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
