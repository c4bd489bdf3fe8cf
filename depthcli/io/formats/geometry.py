"""Depth in space by its camera: points and meshes as PLY and glTF 2.0, normals as 16-bit PNG."""

import json
import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.camera import CameraSource, focal_px_of_crop, focal_px_of_hfov, hfov_deg
from depthcli.core.options import one_line
from depthcli.core.surface import Surface, surface_of
from depthcli.core.types import DepthMap, Float32Array, Frame
from depthcli.errors import Message, OutputError
from depthcli.io.formats.table import WriterOptions
from depthcli.io.images.png import encode_png
from depthcli.io.media import KEY_PREFIX
from depthcli.io.stored.metadata import SOFTWARE, metadata_texts, own_texts

_NYU = focal_px_of_hfov(63.3, 640), (640, 480)  # assumed if the map states no focal length
_HALF = 65535 / 2


class SurfaceWriter(WriterOptions):
    """Formats that show a map in space."""

    _fills_edges = False

    def surface(self, depth: DepthMap) -> tuple[Surface, tuple[Message, ...]]:
        """The points of a map by its camera, and warnings about that."""
        focal_px, warnings = camera_of(depth)
        if self.max_error is not None:
            if depth.error is None:
                raise OutputError("the error of depth is not known", "leave {max_error} out")
            is_sure = depth.error <= self.max_error
            depth = replace(depth, values=np.where(is_sure, depth.values, np.float32(np.nan)))
        surface = surface_of(
            depth,
            focal_px,
            stride=self.stride or 1,
            max_depth_m=self.max_depth_m,
            keep_edges=self.keep_edges,
            fill_edges=self._fills_edges,
        )
        if not surface.valid.any():
            raise OutputError(
                "no point is left", "raise {max_depth_m} or {max_error}, or lower {stride}"
            )
        return surface, warnings

    def joined(self, surface: Surface) -> Surface:
        """The surface, whose triangles reach across edges if these are kept."""
        return replace(surface, steepest=math.inf) if self.keep_edges else surface


def camera_of(depth: DepthMap) -> tuple[float, tuple[Message, ...]]:
    """The focal length of a map in pixels, and a warning if it is assumed."""
    if not depth.is_metric:
        raise OutputError(
            f"a point in space needs metres, and {depth.kind} depth has none",
            "predict with {anchors} of known depth",
        )
    source = depth.provenance
    if source.is_cropped:
        raise OutputError(
            "the focal length of the depth is for an image of another size",
            "give {focal_px} or {hfov} of this one",
        )
    aspect = source.pixel_aspect
    assumed_px = focal_px_of_crop(*_NYU, (depth.width * aspect, depth.height)) / aspect
    focal_px = source.focal_px or assumed_px
    is_known = source.focal_px and source.camera_source is not CameraSource.CARD
    if is_known or source.projection.is_other:
        return focal_px, ()
    text = f"no focal length is known; an hfov of {hfov_deg(focal_px, depth.width):.3g}° is assumed"
    return focal_px, (Message(text, "give {focal_px} or {hfov}"),)


class NormalsWriter(WriterOptions):
    """Red is x to the right, green y up, blue z towards the camera; -1 to 1 as 0 to 65535."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write unit normals; 0, 0, 0 where there is no depth."""
        focal_px, warnings = camera_of(depth)
        surface = surface_of(depth, focal_px)
        stored = np.rint((surface.normals() * np.array([1, -1, -1], np.float32) + 1) * _HALF)
        stored[~surface.valid] = 0
        texts = own_texts(metadata_texts(depth) | {"normals": "OpenGL"})
        path.write_bytes(encode_png(stored.astype(np.uint16), texts))
        return warnings


_FLOATS, _BYTES = ("x", "y", "z", "nx", "ny", "nz"), ("red", "green", "blue")
_PROPERTIES = [f"float {name}" for name in _FLOATS] + [f"uchar {name}" for name in _BYTES]
_POINT = [("xyz_m", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)]
_FACE = [("count", "u1"), ("numbers", "<u4", 3)]


class PlyWriter(SurfaceWriter):
    """Metres: x right, y down, z along the camera axis; normals towards the camera."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write one vertex for each pixel with depth; comments in the header have the metadata."""
        surface, warnings = self.surface(depth)
        valid = surface.valid
        points = np.empty(int(valid.sum()), _POINT)
        points["xyz_m"], points["normal"] = surface.xyz_m[valid], surface.normals()[valid]
        points["rgb"] = 255
        if frame is not None:
            points["rgb"] = frame.pixels_8bit()[:: self.stride or 1, :: self.stride or 1][valid]
        numbers = self.joined(surface).faces() if self.faces else np.empty((0, 3), np.uint32)
        faces = np.empty(len(numbers), _FACE)
        faces["count"], faces["numbers"] = 3, numbers
        texts = metadata_texts(depth)
        for name in ("camera", "camera_size_px"):  # focal_px and camera_source say it in ASCII
            texts.pop(name, None)
        lines = ["ply", "format binary_little_endian 1.0"]
        lines += [one_line(f"comment {KEY_PREFIX}{name} {text}") for name, text in texts.items()]
        lines += [f"element vertex {len(points)}"]
        lines += [f"property {declaration}" for declaration in _PROPERTIES]
        if self.faces:
            lines += [f"element face {len(faces)}", "property list uchar uint vertex_indices"]
        with path.open("wb") as file:
            file.write(("\n".join(lines) + "\nend_header\n").encode("ascii", "backslashreplace"))
            file.write(points.data)  # tofile reports no error when the disk is full
            file.write(faces.data)
        return warnings


# https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
_MAGIC, _VERSION = 0x46546C67, 2
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_FLOAT, _UNSIGNED_INT = 5126, 5125
_VERTICES, _INDICES = 34962, 34963  # what a buffer view is for
_JPEG_QUALITY = 92
_MOST_TEXTURE_PX = 8192
_NEAR_M = 0.01
_ALIGNMENT = 4
_CLAMPED = 33071  # at the ends of a texture


class Mesh(NamedTuple):
    """Triangles in metres: x right, y up, z backwards."""

    xyz_m: Float32Array  #: (N, 3) vertices
    faces: npt.NDArray[np.uint32]  #: (M, 3) numbers of vertices, counterclockwise to the camera
    places: npt.NDArray[np.intp]  #: (N, 2) row and column of each in the thinned map


class MeshWriter(SurfaceWriter):
    """Triangles between neighbours, cut along edges of depth.

    Where they are cut, the farther surface goes on as far as the camera sees it.
    """

    _fills_edges = True  # which the camera would see as a black outline

    def mesh(self, depth: DepthMap) -> tuple[Mesh, tuple[Message, ...]]:
        """The triangles of a map by its camera, and warnings about that."""
        surface, warnings = self.surface(depth)
        surface = self.joined(surface)
        xyz_m, faces, (gaps, gaps_m) = surface.xyz_m[surface.valid], surface.faces(), surface.gaps()
        places = np.argwhere(surface.valid)
        if len(gaps):
            first = np.arange(len(xyz_m), len(xyz_m) + 4 * len(gaps), 4, dtype=np.uint32)
            two = first[:, np.newaxis] + np.array([0, 2, 1, 1, 2, 3], np.uint32)
            faces = np.concatenate([faces, two.reshape(-1, 3)])
            xyz_m = np.concatenate([xyz_m, gaps_m.reshape(-1, 3)])
            places = np.concatenate([places, gaps.reshape(-1, 2)])
        xyz_m *= np.array([1, -1, -1], np.float32)
        return Mesh(xyz_m, faces, places), warnings

    def uv(self, mesh: Mesh, depth: DepthMap) -> Float32Array:
        """The middle of each vertex's pixel in the image, (N, 2), from 0 at the top left to 1."""
        middles = (mesh.places * (self.stride or 1) + 0.5)[:, ::-1]
        return (middles / (depth.width, depth.height)).astype(np.float32)


class GlbWriter(MeshWriter):
    """Metres: x right, y up, the camera at the origin looks along -z."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the mesh with the image on it."""
        mesh, warnings = self.mesh(depth)
        buffer, name = _Buffer(), frame.path.stem if frame and frame.path else "depth"
        attributes = {"POSITION": buffer.add_array(mesh.xyz_m, _VERTICES, "VEC3", ends=True)}
        indices = buffer.add_array(mesh.faces.reshape(-1), _INDICES, "SCALAR")
        document: dict[str, Any] = {"asset": {"generator": SOFTWARE, "version": "2.0"}}
        if frame is None:
            material: dict[str, Any] = {"doubleSided": True}
        else:
            attributes["TEXCOORD_0"] = buffer.add_array(self.uv(mesh, depth), _VERTICES, "VEC2")
            view = buffer.add_bytes(texture_jpeg(frame))
            document |= {
                "extensionsUsed": ["KHR_materials_unlit"],
                "images": [{"name": name, "bufferView": view, "mimeType": "image/jpeg"}],
                "samplers": [{"wrapS": _CLAMPED, "wrapT": _CLAMPED}],
                "textures": [{"source": 0, "sampler": 0}],
            }
            material = _UNLIT
        primitive = {"attributes": attributes, "indices": indices, "material": 0}
        document |= {
            "scene": 0,
            "scenes": [{"name": name, "nodes": [0]}],
            "nodes": [{"name": name, "mesh": 0, "extras": metadata_texts(depth)}],
            "meshes": [{"name": name, "primitives": [primitive]}],
            "materials": [{"name": name, **material}],
            **buffer.tables(),
        }
        if not depth.provenance.projection.is_other:
            # glTF has no principal point.
            aspect = depth.provenance.pixel_aspect
            yfov = 2 * math.atan(depth.height / 2 / (camera_of(depth)[0] * aspect))
            ratio = depth.width * aspect / depth.height
            perspective = {"aspectRatio": ratio, "yfov": yfov, "znear": _NEAR_M}
            camera = {"name": "camera", "type": "perspective", "perspective": perspective}
            document["cameras"] = [camera]
            document["nodes"].append({"name": "camera", "camera": 0})
            document["scenes"][0]["nodes"].append(1)
        with path.open("wb") as file:  # in parts, as a copy takes .5 GB of 12 megapixels
            file.writelines((_head(document, len(buffer.data)), buffer.data))
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
        self.data += data.ljust(len(data) + -len(data) % _ALIGNMENT, b"\0")
        return len(self._views) - 1

    def tables(self) -> dict[str, Any]:
        """The tables, by name."""
        return {
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self.data)}],
        }


def texture_jpeg(frame: Frame) -> bytes:
    """The image as JPEG, no larger than graphics cards take."""
    bgr = np.ascontiguousarray(frame.pixels_8bit()[..., ::-1])
    share = _MOST_TEXTURE_PX / max(frame.width, frame.height)
    if share < 1:
        size = [max(1, round(side * share)) for side in (frame.width, frame.height)]
        bgr = np.asarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), np.uint8)
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def _head(document: dict[str, Any], size: int) -> bytes:
    """A file of a JSON and a binary chunk, up to the binary data, which are of this size."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % _ALIGNMENT)
    length = 12 + 8 + len(text) + 8 + size
    head = struct.pack("<III", _MAGIC, _VERSION, length) + struct.pack("<II", len(text), _JSON)
    return head + text + struct.pack("<II", size, _BINARY)
