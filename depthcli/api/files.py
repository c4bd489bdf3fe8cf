"""Depth files and depth videos as maps with the methods of the Python API."""

import os
import warnings
from collections.abc import Iterator

import numpy as np

from depthcli.api.depth_map import DepthMap
from depthcli.core import types
from depthcli.errors import DepthcliWarning, InputError
from depthcli.io.depth import read as depth_files
from depthcli.io.storage.remote import path_of
from depthcli.video import depth as depth_videos


class DepthVideo(depth_videos.DepthVideo):
    """A 16-bit gray video of depth, whose frames have the methods of :class:`DepthMap`."""

    def __iter__(self) -> Iterator[DepthMap]:
        """Depth maps, from the beginning, with one in memory."""
        return map(_with_nan, super().__iter__())


def read_depth(path: str | os.PathLike[str], *, png_scale: float | None = None) -> DepthMap:
    """Depth of a 16-bit PNG, EXR or NPY file, with the file's metadata about model and camera.

    Values that are no depth (infinity; metres of 0 or less) are NaN.
    A ``DepthcliWarning`` tells if the sidecar beside it is that of another map, or if a PNG states
    no scale and none is given.

    Args:
        path: the file, with the suffix of its format.
        png_scale: units per metre of a PNG, None for what the file states, or millimetres; or of
            integers in an NPY file, which need it to be metric.

    Raises:
        InputError: missing, damaged, without depth, or metric integers without a scale.
        UsageError: a scale for an NPY file of floats, which are metres.
    """
    path = path_of(path)
    if path.suffix.lower() == ".mkv":
        raise InputError(f"{path} is a video; depthcli.DepthVideo reads the maps in it")
    stored = depth_files.read_stored_depth(path, png_scale=png_scale)
    for message in stored.warnings_with_scale("png_scale"):
        warnings.warn(message, DepthcliWarning, stacklevel=2)
    return _with_nan(stored.displayed)


def _with_nan(depth: types.DepthMap) -> DepthMap:
    """The map with NaN where there is no depth; files also have infinity, and 0 m or less."""
    values = np.where(depth.valid, depth.values, np.float32(np.nan))
    return DepthMap(values, depth.kind, depth.provenance)
