"""A textured mesh as binary glTF 2.0, for Blender, game engines and browsers.

Source: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.surface import Surface
from depthcli.core.types import DepthMap, Frame
from depthcli.io.depth.metadata import SOFTWARE, metadata_texts
from depthcli.io.formats.geometry import SurfaceWriter

_MAGIC, _VERSION = 0x46546C67, 2
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_FLOAT, _UNSIGNED_INT = 5126, 5125
_VERTICES, _INDICES = 34962, 34963  # what a buffer view is for
_JPEG_QUALITY = 92
_ALIGNMENT = 4


class GlbWriter(SurfaceWriter):
    """Metres: x right, y up, the camera at the origin looks along -z."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write triangles between neighbours, cut along edges of depth, with the image on them."""
        surface, warnings = self.surface(depth)
        xyz_m = surface.xyz_m[surface.valid] * np.array([1, -1, -1], np.float32)
        buffer = _Buffer()
        attributes = {"POSITION": buffer.add_array(xyz_m, _VERTICES, "VEC3", ends=True)}
        indices = buffer.add_array(surface.faces().reshape(-1), _INDICES, "SCALAR")
        document: dict[str, Any] = {"asset": {"generator": SOFTWARE, "version": "2.0"}}
        if frame is None:
            material: dict[str, Any] = {"doubleSided": True}
        else:
            uv = _texture_coordinates(surface, depth, self.stride)
            attributes["TEXCOORD_0"] = buffer.add_array(uv, _VERTICES, "VEC2")
            document |= _texture(buffer, frame)
            material = _UNLIT
        mesh = {"attributes": attributes, "indices": indices, "material": 0}
        document |= {
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "extras": metadata_texts(depth)}],
            "meshes": [{"primitives": [mesh]}],
            "materials": [material],
            **buffer.tables(),
        }
        path.write_bytes(_glb(document, bytes(buffer.data)))
        return warnings


# The light of the scene is in the image already.
_UNLIT = {
    "doubleSided": True,
    "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0},
    "extensions": {"KHR_materials_unlit": {}},
}


class _Buffer:
    """The binary part, and the tables that describe it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self._views: list[dict[str, int]] = []
        self._accessors: list[dict[str, Any]] = []

    def add_array(
        self, array: npt.NDArray[Any], target: int, shape: str, *, ends: bool = False
    ) -> int:
        """Append an array; returns the number of its accessor, with least and largest values."""
        view = self.add_bytes(np.ascontiguousarray(array).tobytes(), target=target)
        kind = _FLOAT if array.dtype == np.float32 else _UNSIGNED_INT
        accessor = {"bufferView": view, "componentType": kind, "count": len(array), "type": shape}
        if ends:
            accessor |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def add_bytes(self, data: bytes, **facts: int) -> int:
        """Append bytes; returns the number of their view."""
        self._views.append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **facts}
        )
        self.data += data + bytes(-len(data) % _ALIGNMENT)
        return len(self._views) - 1

    def tables(self) -> dict[str, Any]:
        """The tables, by name."""
        return {
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self.data)}],
        }


def _texture_coordinates(surface: Surface, depth: DepthMap, stride: int) -> npt.NDArray[np.float32]:
    """Middle of each point's pixel in the image, from 0 at the top left to 1; (N, 2) float32."""
    y, x = np.nonzero(surface.valid)
    uv = (x * stride + 0.5) / depth.width, (y * stride + 0.5) / depth.height
    return np.stack(uv, 1).astype(np.float32)


def _texture(buffer: _Buffer, frame: Frame) -> dict[str, Any]:
    """The entries of the image as a texture."""
    bgr = np.ascontiguousarray(frame.pixels_8bit()[..., ::-1])
    jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
    clamped = 33071
    return {
        "extensionsUsed": ["KHR_materials_unlit"],
        "images": [{"bufferView": buffer.add_bytes(jpeg), "mimeType": "image/jpeg"}],
        "samplers": [{"wrapS": clamped, "wrapT": clamped}],
        "textures": [{"source": 0, "sampler": 0}],
    }


def _glb(document: dict[str, Any], data: bytes) -> bytes:
    """A file of a JSON and a binary chunk."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % _ALIGNMENT)
    length = 12 + 8 + len(text) + 8 + len(data)
    head = struct.pack("<III", _MAGIC, _VERSION, length) + struct.pack("<II", len(text), _JSON)
    return head + text + struct.pack("<II", len(data), _BINARY) + data
