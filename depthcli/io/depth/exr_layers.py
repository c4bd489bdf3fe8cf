"""The layers of an OpenEXR file, and the channel that holds its depth.

Names follow the conventions of Blender, Nuke, Arnold, V-Ray, RenderMan, Houdini and Redshift.
"""

from collections.abc import Collection, Sequence

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
    """What precedes the last part of a channel's name: ``depth.`` of ``depth.Z``, or ""."""
    return name.removesuffix(last_part(name))


def last_part(name: str) -> str:
    """The part of a name after its last dot: ``Z`` of ``depth.Z``."""
    return name.rpartition(".")[2]


def _depth_rank(name: str) -> tuple[int, int, str]:
    last, layer = last_part(name), layer_of(name)
    signs = (name == "Z", "depth" in layer.lower(), last != "R" and not layer, last != "R", True)
    return signs.index(True), _DEPTHS.index(last), name
