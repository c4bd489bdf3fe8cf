"""Reading the depth in OpenEXR files of depthcli and of other tools."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from depthcli.core.text import one_line
from depthcli.core.types import DepthMap, Frame
from depthcli.core.windows import Windows
from depthcli.errors import InputError
from depthcli.io.depth.exr import read_exr_texts
from depthcli.io.depth.exr_channels import StoredChannel, read_exr_channels
from depthcli.io.depth.metadata import kind_named, own_metadata, provenance_of
from depthcli.io.depth.sidecar import with_sidecar
from depthcli.io.depth.stored import StoredDepth

_CHANNELS = ("Z", "V", "Y", "R")
_COLOURS = ("G", "B", "RY", "BY")


def read_exr_depth(path: Path) -> StoredDepth:
    """Depth of an EXR over its data window, (H, W) float32.

    Raises:
        InputError: missing, damaged, without depth, or too large.
    """
    channels = read_exr_channels(path)
    name = depth_channel(list(channels))
    if name is None:
        raise InputError(
            f"{path} has no channel Z, V, Y or R; it has {one_line(', '.join(channels))}"
        )
    stored = channels[name]
    layer = name[: -len(name.rpartition(".")[2])]
    for colour in _COLOURS:
        other = channels.get(layer + colour)
        if name != layer + "Z" and not (other is None or _is_same(other, stored)):
            raise InputError(
                f"{path} holds colours, not depth; it has {one_line(', '.join(channels))}"
            )
    size_px = stored.display.width, stored.display.height
    metadata, problems = with_sidecar(path, own_metadata(read_exr_texts(path)), size_px)
    values = stored.over(stored.data)
    depth = DepthMap(values, kind_named(metadata.get("kind")), provenance_of(metadata))
    frame = Frame(
        np.zeros((1, 1), np.uint8),
        rate=stored.rate,
        pixel_aspect=stored.pixel_aspect,
        windows=Windows(stored.data, stored.data, stored.display),
    )
    return StoredDepth(str(path), depth, metadata, frame=frame, warnings=problems)


def _is_same(one: StoredChannel, other: StoredChannel) -> bool:
    """Whether two channels have the same values, as gray has that is stored as three colours."""
    return np.array_equal(one.over(one.display), other.over(other.display), equal_nan=True)


def depth_channel(names: Sequence[str]) -> str | None:
    """The channel that holds depth, in files of any program; None if there is none.

    That is ``Z``, else Z, V, Y or R of a layer called depth (Nuke's ``depth.Z``, Blender's
    ``ViewLayer.Depth.Z``), else a V or Y, else another layer's Z, V or Y, else an R.
    """
    depths = [name for name in names if name.rpartition(".")[2] in _CHANNELS]
    return min(depths, key=_channel_rank, default=None)


def _channel_rank(name: str) -> tuple[int, int, str]:
    layer, _, last = name.rpartition(".")
    signs = (name == "Z", "depth" in layer.lower(), last != "R" and not layer, last != "R", True)
    return signs.index(True), _CHANNELS.index(last), name
