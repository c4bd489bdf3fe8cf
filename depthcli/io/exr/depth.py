"""Reading the depth in OpenEXR files of depthcli and of other tools."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from depthcli.core.text import one_line
from depthcli.core.types import DepthMap, Frame, Provenance, Windows
from depthcli.errors import InputError
from depthcli.io.depth.metadata import kind_named, own_metadata, provenance_of
from depthcli.io.depth.sidecar import with_sidecar
from depthcli.io.depth.stored import StoredDepth
from depthcli.io.exr.file import StoredChannel, read_exr_channels, read_exr_texts
from depthcli.io.exr.layers import depth_channel, layer_of
from depthcli.io.storage.transfer import local_copy

_COLOURS = ("G", "B", "RY", "BY")


def read_exr_depth(path: Path) -> StoredDepth:
    """Depth of an EXR over its data window, (H, W) float32.

    Raises:
        InputError: missing, damaged, without depth, or too large.
    """
    with local_copy(path) as file:  # one download for both
        channels, texts = read_exr_channels(file), read_exr_texts(file)
    name = depth_channel(list(channels))
    if name is None or _is_coloured(name, channels):
        raise InputError(f"{path} holds no depth; it has {one_line(', '.join(channels))}")
    stored, part = channels[name], channels[name].part
    size_px = part.display.width, part.display.height
    metadata, problems = with_sidecar(path, own_metadata(texts), size_px)
    values = stored.over(part.data)
    source = provenance_of(metadata)
    if part.pixel_aspect != 1:
        source = replace(source or Provenance(), pixel_aspect=part.pixel_aspect)
    depth = DepthMap(values, kind_named(metadata.get("kind")), source)
    frame = Frame(
        np.zeros((1, 1), np.uint8),
        rate=part.rate,
        pixel_aspect=part.pixel_aspect,
        windows=Windows(part.data, part.data, part.display),
        time_code=part.time_code,
    )
    return StoredDepth(str(path), depth, metadata, frame=frame, channel=name, warnings=problems)


def _is_coloured(name: str, channels: Mapping[str, StoredChannel]) -> bool:
    """Whether a channel belongs to a colour picture; gray may be stored as three equal colours."""
    layer = layer_of(name)
    others = [] if name == layer + "Z" else [channels.get(layer + colour) for colour in _COLOURS]
    return not all(other is None or _is_same(other, channels[name]) for other in others)


def _is_same(one: StoredChannel, other: StoredChannel) -> bool:
    """Whether two channels have the same values, as gray has that is stored as three colours."""
    shown, other_shown = (stored.over(stored.part.display) for stored in (one, other))
    return np.array_equal(shown, other_shown, equal_nan=True)
