"""Reading a depth file of depthcli or of another program, in any format that is read."""

from collections.abc import Mapping
from pathlib import Path

from depthcli.errors import InputError
from depthcli.io.depth.embedded import read_embedded_depth
from depthcli.io.formats import png16
from depthcli.io.formats.table import READABLE_SUFFIXES, readable_format, reader_of
from depthcli.io.storage.paths import path_of
from depthcli.io.stored.depth import AS_STATED, DepthReadOptions, StoredDepth

_IMAGES = (".jpg", ".jpeg", ".heic", ".heif", ".hif")  # that phones store depth in


def read_stored_depth(path: str | Path, options: DepthReadOptions = AS_STATED) -> StoredDepth:
    """Depth of a file in a format that is read, chosen by its suffix.

    Returns:
        (H, W); NaN where there is no depth. Its provenance is what the file or the sidecar beside
        it states of model, camera, known points and orientation.
    """
    path = path_of(path)
    format_ = readable_format(path)
    if format_ is not None:
        return reader_of(format_)(path, options)
    stored = read_embedded_depth(path, options) if path.suffix.lower() in _IMAGES else None
    if stored is None:
        problem = f"{path} is not a depth file ({', '.join(READABLE_SUFFIXES)}, .mkv)"
        raise InputError(problem, "'depthcli predict' and 'depthcli video' estimate depth")
    return stored


def read_metadata(path: Path) -> Mapping[str, str]:
    """Metadata of a depth file and its sidecar, texts by name; a PNG is not decoded for it."""
    if path.suffix.lower() == ".png":
        return png16.read_metadata(path)
    return read_stored_depth(path).metadata
