"""Choosing the channels of an OpenEXR file that hold its image.

Names follow the conventions of Blender, Nuke, Arnold, V-Ray, RenderMan, Houdini and Redshift.
"""

import re
from collections.abc import Collection, Mapping, Sequence

from depthcli.core.options import one_line
from depthcli.errors import InputError, Message

_DEPTHS = ("Z", "V", "Y", "R")


def depth_channel(names: Sequence[str]) -> str | None:
    """The channel that holds depth, in files of any program; None if there is none.

    That is ``Z``, else Z, V, Y or R of a layer called depth (Nuke's ``depth.Z``, Blender's
    ``ViewLayer.Depth.Z``), else a V or Y, else another layer's Z, V or Y, else an R. Layers of
    vectors are none of these.
    """
    depths = [
        name for name in names if last_part(name) in _DEPTHS and not is_of_vectors(name, names)
    ]
    return min(depths, key=_depth_rank, default=None)


def is_of_vectors(name: str, names: Collection[str]) -> bool:
    """Whether a channel is of normals, positions, motion (X, Y, Z) or texture coordinates (U, V).

    ``names`` are those of all channels.
    """
    layer = layer_of(name)
    return layer + "X" in names or layer + "U" in names


def layer_of(name: str) -> str:
    """Prefix of a channel's name: ``depth.`` of ``depth.Z``, or ""."""
    return name.removesuffix(last_part(name))


def last_part(name: str) -> str:
    """The part of a name after its last dot: ``Z`` of ``depth.Z``."""
    return name.rpartition(".")[2]


def _depth_rank(name: str) -> tuple[int, int, str]:
    last, layer = last_part(name), layer_of(name)
    signs = (name == "Z", "depth" in layer.lower(), last != "R" and not layer, last != "R", True)
    return signs.index(True), _DEPTHS.index(last), name


_NOTATIONS = (("r", "g", "b"), ("red", "green", "blue"))
"""What the channels of a colour image are called, in upper or lower case."""
_UNNAMED = ("rgba", "rgb")
"""What the layer without a name is called where layers are chosen."""
_PICTURES = ("", "rgba", "rgb", "combined", "beauty", "c", "ci", "main", "diffuse", "albedo")
"""Last parts of the names of layers that hold the image, the likeliest first."""
_DATA = re.compile(r"n|p|z|uv|.*(normal|position|depth|motion|velocity|crypto).*")
"""Last parts of the names of layers whose R, G and B may be no colours."""
_MAX_SHOWN = 4


def colour_channels(
    file: str, names: Sequence[str], layer: str | None = None
) -> tuple[tuple[str, ...], str | None]:
    """The channels of the image, and a warning if it may be another one.

    Without ``layer``, that is R, G and B, or Y, without a layer; else R, G and B of the layer or
    part whose name says that it is the image, else of one whose name does not say that it is
    data; of several, the first. R, G and B may be called red, green and blue, in any case.

    Args:
        file: what messages call it.
        names: all channels of the file, in its order.
        layer: name of the layer or part; the last part of it if no other has the same, in upper or
            lower case. ``rgba`` and ``rgb`` are that without a name if none has these.

    Returns:
        The names of R, G and B, or of Y; and one line, or None.

    Raises:
        InputError: there is no such layer.
    """
    coloured = _coloured_layers(names)
    if layer is not None:
        return _channels_of(file, names, coloured, layer), None
    if "Y" in names and "" not in coloured and not is_of_vectors("Y", names):
        return ("Y",), None
    if not coloured:
        shown = one_line(", ".join(names))
        raise InputError(f"{file} holds no picture in R, G, B or Y", f"it has {shown}")
    ranks = {layer: _picture_rank(layer) for layer in coloured}
    likely = [layer for layer, rank in ranks.items() if rank == min(ranks.values())]
    return coloured[likely[0]], _doubt(likely)


def _coloured_layers(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """R, G and B of each layer that has them in one notation, by what precedes them."""
    found: dict[tuple[str, str], str] = {}
    for name in names:  # R precedes r, and r red, in a file, so R is used if there are several
        found.setdefault((layer_of(name), last_part(name).lower()), name)
    layers: dict[str, tuple[str, ...]] = {}
    for layer, colour in found:
        for notation in _NOTATIONS:
            wanted = [(layer, other) for other in notation]
            if colour == notation[0] and found.keys() >= set(wanted):
                layers.setdefault(layer, tuple(found[key] for key in wanted))
    return layers


def _channels_of(
    file: str, names: Sequence[str], coloured: Mapping[str, tuple[str, ...]], layer: str
) -> tuple[str, ...]:
    """R, G and B, or Y, of a layer by its name."""
    grays = [name for name in names if last_part(name) == "Y" and not is_of_vectors(name, names)]
    channels = {**{layer_of(gray): (gray,) for gray in grays}, **coloured}
    found = {prefix.removesuffix("."): prefix for prefix in channels if prefix}
    wanted = layer.removesuffix(".").lower()
    same = [name for name in found if name.lower() == wanted]
    chosen = same or [name for name in found if last_part(name).lower() == wanted]
    if not chosen and wanted in _UNNAMED and "" in channels:
        return channels[""]
    if len(chosen) != 1:
        which = "has several layers" if chosen else "has no layer"
        shown = one_line(", ".join(chosen or found or names))
        raise InputError(f"{file} {which} {layer!r} with R, G and B, or Y", f"it has {shown}")
    return channels[found[chosen[0]]]


def _picture_rank(layer: str) -> int:
    """Rank of a layer by its name; 0 is the likeliest to hold the image."""
    name = last_part(layer.removesuffix(".")).lower()
    if name in _PICTURES:
        return _PICTURES.index(name)
    return len(_PICTURES) + bool(_DATA.fullmatch(name))


def _doubt(likely: Sequence[str]) -> str | None:
    """A warning about several layers that are as likely to hold the image; None for one."""
    if len(likely) == 1:
        return None
    used, *others = (one_line(layer.removesuffix(".")) for layer in likely)
    more = f" and {len(others) - _MAX_SHOWN} others" if len(others) > _MAX_SHOWN else ""
    shown = ", ".join(others[:_MAX_SHOWN])
    return Message(f"its layer {used} is used", f"if it is in {shown}{more}, give {{layer}}")
