"""What the sidecar of a depth file, a JSON file beside it, adds to the facts that it states."""

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from depthcli.core.types import AnchorFit
from depthcli.core.validation import FieldError, parsed_json
from depthcli.errors import Message, OutputError, os_errors_as
from depthcli.io.storage.paths import read_regular
from depthcli.io.stored import metadata

_MAX_SIDECAR_BYTES = 2**26  # with a line for each frame of a long video
_NUMBER = re.compile(r"[._\- ]*(\d+)", re.ASCII)
SIDECAR_ENDS = ("png16_min", "png16_max")
_SHARED = (
    *("software", "kind", "orientation", "time_s", "projection", "network_size_px", "anchors"),
    *metadata.ORIGIN_FIELDS,
)


class FileMetadata(NamedTuple):
    """Facts that a depth file and the sidecar beside it state."""

    texts: Mapping[str, str]  #: by name
    warnings: tuple[str, ...] = ()  #: about the sidecar, one line each


def with_sidecar(path: Path, own: Mapping[str, str], size_px: tuple[int, int]) -> FileMetadata:
    """The metadata of a depth file, completed from its sidecar, or from that of its video.

    ``own`` is what the file itself states, ``size_px`` (columns, rows) of its map. A warning tells
    if the sidecar is that of another map.
    """
    own, warnings = metadata.of_size(own, size_px, path.name)
    found = _find_sidecar(path)
    if found is None:
        return FileMetadata(own, warnings)
    sidecar, fields = found
    if not _describes(fields, own, size_px):
        ignored = f"{sidecar} describes another map than {path.name} and is ignored"
        advice = Message(ignored, "remove it, or write it again with {sidecar}")
        return FileMetadata(own, (*warnings, advice))
    texts = {name: _text(fields[name]) for name in _SHARED if fields.get(name) is not None}
    if "software" in own:  # without a principal point, the file has that of its middle
        texts.pop("centre_px", None)
    if path.suffix.lower() in {".png", ".pgm"} and "scale" not in own:
        texts |= _png_scale_texts(fields)
    return FileMetadata({**texts, **own}, warnings)


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


def _read_sidecar(path: Path) -> dict[str, object]:
    """The content of a sidecar of depthcli; empty if there is none."""
    try:
        fields = _parsed(read_regular(path, _MAX_SIDECAR_BYTES))
    except (OSError, FieldError):
        return {}
    if not (isinstance(fields, dict) and str(fields.get("software")).startswith("depthcli ")):
        return {}
    return dict(fields)


@lru_cache(maxsize=1)
def _parsed(sidecar: bytes) -> object:
    """The value of a sidecar, which all frames of a long video share; not to be changed."""
    return parsed_json(sidecar)


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
    low, high = (metadata.number(_text(end)) for end in ends)
    if fields.get("png16_inverse") and low and high:
        return {"scale": "inverse", "range": f"{1 / high} {1 / low}"}
    return {"scale": "normalized", "range": f"{low} {high}"}


def _text(value: object) -> str:
    if isinstance(value, dict):  # of the fit to known points
        value = [value.get(name) for name in AnchorFit._fields]
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)
