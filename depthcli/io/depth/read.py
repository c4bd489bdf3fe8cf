"""Reading a depth file of depthcli or of another program, in any format, or within an image.

Phones store depth in HEIC, and in JPEG as Android's do. Sources: ISO/IEC 23008-2, depth
representation information; Google's Depthmap Metadata (GDepth, in XMP) and Dynamic Depth 1.0
(DepthMap, a file after the image).
"""

import base64
import binascii
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from depthcli.core.options import DepthEncoding
from depthcli.core.types import AnyArray, Float32Array
from depthcli.errors import InputError
from depthcli.io.formats import raster, table
from depthcli.io.images import heif, jpeg, tiff
from depthcli.io.images.pixels import upright
from depthcli.io.images.read import check, reader_errors
from depthcli.io.storage.paths import path_of, read_bytes
from depthcli.io.stored.depth import AS_STATED, DepthReadOptions, StoredDepth

_IMAGES = (".jpg", ".jpeg", ".heic", ".heif", ".hif")  # that phones store depth in


def read_stored_depth(path: str | Path, options: DepthReadOptions = AS_STATED) -> StoredDepth:
    """Depth of a file in a format that is read, chosen by its suffix.

    Returns:
        (H, W); NaN where there is no depth. Its provenance is what the file or the sidecar beside
        it states of model, camera, known points and orientation.
    """
    path = path_of(path)
    read = table.reader_of(path)
    if read is not None:
        return read(path, options)
    stored = read_embedded_depth(path, options) if path.suffix.lower() in _IMAGES else None
    if stored is None:
        problem = f"{path} is not a depth file ({', '.join(table.READABLE_SUFFIXES)}, .mkv)"
        raise InputError(problem, "'depthcli predict' and 'depthcli video' estimate depth")
    return stored


def read_metadata(path: Path) -> Mapping[str, str]:
    """Metadata of a depth file and its sidecar, texts by name; a PNG is not decoded for it."""
    if path.suffix.lower() == ".png":
        return raster.read_metadata(path)
    return read_stored_depth(path).metadata


_XMP, _MORE_XMP = b"http://ns.adobe.com/xap/1.0/\0", b"http://ns.adobe.com/xmp/extension/\0"
_MORE_HEAD_BYTES = len(_MORE_XMP) + 32 + 4  # and a digest and the length of all, before its place
_FACTS = re.compile(rb"(?:GDepth|DepthMap):(\w+)(?:\s*=\s*[\"']|>)([^\"'<]*)")
_RELATIVE = re.compile(rb"depthData:Accuracy\W{1,3}relative")
_INVERSE_Z, _DISPARITY, _Z = 0, 1, 2  # kinds of representation, each uniform in the numbers
_ENDS: dict[int, tuple[str, ...]] = {  # names of the least and the largest number
    _INVERSE_Z: ("z_far", "z_near"),
    _DISPARITY: ("d_min", "d_max"),
    _Z: ("z_near", "z_far"),
}
_UNITS_M = {"m": 1.0, "meters": 1.0, "mm": 1e-3}
_ITEM = re.compile(rb"<Container:Item\b[^>]*>")  # of the files after the image, in their order
_LENGTH = re.compile(rb"Item:Length=[\"'](\d+)")
Found: TypeAlias = tuple[Float32Array, dict[str, str], tuple[str, ...]]
"""Depth, upright; facts as depth files state them; warnings."""


def read_embedded_depth(path: Path, options: DepthReadOptions) -> StoredDepth | None:
    """Depth within an image, of a size of its own; None if there is none."""
    data = read_bytes(path)
    if data.startswith(jpeg.JPEG_START):
        image = _of_jpeg(data, str(path))
    elif heif.is_heif(data):
        image = _auxiliary(data, str(path))
    else:
        return None
    if image is None:
        return None
    values, texts, warnings = image
    if texts.pop("measure", "") == "OpticRay" and options.kind is None:
        options = replace(options, kind=DepthEncoding.DISTANCE)
    stored = StoredDepth.of(path, values, texts, options, has_sidecar=False)
    return replace(stored, warnings=(*warnings, *stored.warnings))


def _auxiliary(data: bytes, name: str) -> Found | None:
    """Depth of the primary image of a HEIC, as of iPhones."""
    with reader_errors(name):
        images = heif.depth_images(data)
    if not images:
        return None
    stored, facts = images[0]
    kind = facts.get("representation_type", -1)
    ends = [facts.get(name) for name in _ENDS.get(kind, ("",))]
    if None in ends:
        raise InputError(f"{name} has depth that does not state its range")
    share = stored.astype(np.float64) / np.iinfo(stored.dtype).max
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = np.array(ends, np.float64) ** (-1 if kind == _INVERSE_Z else 1)
        stated = low + share * (high - low)
        values = (stated if kind == _Z else 1 / stated).astype(np.float32)
    is_rough = _RELATIVE.search(data) is not None
    warning = f"{name}: its camera marks depth as relative, so metres may be wrong by a factor"
    return values, {"kind": "metric", "scale": "1"}, (warning,) if is_rough else ()


def _of_jpeg(data: bytes, name: str) -> Found | None:
    bodies = [body for _, body in jpeg.segments(data)]
    first = b"".join(body[len(_XMP) :] for body in bodies if body.startswith(_XMP))
    more = sorted(body[_MORE_HEAD_BYTES:] for body in bodies if body.startswith(_MORE_XMP))
    xmp = first + b"".join(body[4:] for body in more)  # after its place
    facts = {word.decode(): value.decode("latin-1") for word, value in _FACTS.findall(xmp)}
    content = _item(data, xmp)
    if content is None and "Data" not in facts:
        return None
    try:
        near, far = float(facts["Near"]), float(facts["Far"])
        content = content or base64.b64decode(facts["Data"])
        pixels = check(content, f"{name}: its depth").decode().pixels
    except (KeyError, ValueError, binascii.Error) as error:
        raise InputError(f"{name} has depth that is incomplete") from error
    gray: AnyArray = pixels if pixels.ndim == 2 else pixels[..., 0]  # noqa: PLR2004
    share = gray.astype(np.float64) / np.iinfo(gray.dtype).max
    is_linear = facts.get("Format") == "RangeLinear"
    depth = near + share * (far - near) if is_linear else far * near / (far - share * (far - near))
    unit_m = _UNITS_M.get(facts.get("Units", "").lower())
    values = upright(depth * (unit_m or 1), tiff.parse_exif(jpeg.exif_of_jpeg(data)).orientation)
    texts = {"kind": "relative"} if unit_m is None else {"kind": "metric", "scale": "1"}
    texts["measure"] = facts.get("MeasureType", "")
    return np.ascontiguousarray(values, np.float32), texts, ()


def _item(data: bytes, xmp: bytes) -> bytes | None:
    """The file of depth after an image; None if there is none."""
    end = len(data)
    for item in reversed(_ITEM.findall(xmp)):
        length = int(match[1]) if (match := _LENGTH.search(item)) else 0
        if re.search(rb"Semantic=[\"'](?:\w+/)?Depth[\"']", item):
            return data[end - length : end]
        end -= length
    return None
