"""Known depth of a topic in a bag of ROS 2: clouds of lidars, and depth images."""

from dataclasses import replace
from typing import Any

import numpy as np

from depthcli.core.arrays import Float64Array
from depthcli.core.camera import Intrinsics
from depthcli.errors import InputError
from depthcli.io.bags import CLOUD, Origin, Transforms, pixels_of
from depthcli.known.clouds import projected
from depthcli.known.extrinsics import matrix_of, read_extrinsics
from depthcli.known.files import KnownDepthFiles
from depthcli.known.points import KnownDepth

_KINDS = {7: "f4", 8: "f8"}  # of numbers in a PointField
_ENCODINGS = {"16UC1": ("u2", 1000), "mono16": ("u2", 1000), "32FC1": ("f4", 1)}  # REP 118


def read_topic(origin: Origin, files: KnownDepthFiles, camera: Intrinsics) -> KnownDepth:
    """The known depth of an image of a bag; none, with a warning, if no message is near.

    A cloud is taken to the image by ``/tf_static``, or by the extrinsics of the files.

    Raises:
        InputError: the message holds no depth, or its place in the image is not known.
    """
    message = origin.sensor
    if message is None:
        warning = f"no message of {files.topic} within 0.1 s, so depth is not fitted to it"
        return replace(KnownDepth.of(()), warnings=(warning,))
    frame, image_frame = message.header.frame_id, origin.header.frame_id
    if message.__msgtype__ == CLOUD:
        cloud_m = _cloud(message) / (files.scale or 1)
        if files.extrinsics:
            pose, doubts = read_extrinsics(files.extrinsics)
        else:
            pose, doubts = _pose(origin.transforms, frame, image_frame), ()
        points = projected(cloud_m @ pose[:3, :3].T + pose[:3, 3], camera)
        points = replace(points, warnings=doubts + points.warnings)
    elif frame == image_frame:
        points = KnownDepth.of_map(_depth(message, files.scale))
    else:
        problem = f"depth of {files.topic} is of the frame {frame}, and the image of {image_frame}"
        raise InputError(problem, "choose a topic with depth that is aligned to the images")
    if not len(points):
        raise InputError(f"{files.topic} has no point in the image")
    return points.doubted("{anchors_scale} states another")


def _depth(message: Any, units_per_metre: float | None) -> Float64Array:  # noqa: ANN401
    """Metres of a depth image: (H, W) float64; 0 and NaN are unknown."""
    if message.encoding not in _ENCODINGS:
        raise InputError(f"images of encoding {message.encoding} hold no depth")
    kind, units = _ENCODINGS[message.encoding]
    return np.asarray(pixels_of(message, kind)[..., 0] / (units_per_metre or units))


def _cloud(message: Any) -> Float64Array:  # noqa: ANN401
    """The points of a ``PointCloud2`` in its frame: (N, 3) float64; NaN is no point."""
    order = ">" if message.is_bigendian else "<"
    fields = {each.name: each for each in message.fields if each.datatype in _KINDS}
    if not {*"xyz"} <= set(fields):
        raise InputError("a cloud without x, y and z has no known depth")
    dtype = np.dtype(
        {
            "names": [*"xyz"],
            "formats": [order + _KINDS[fields[axis].datatype] for axis in "xyz"],
            "offsets": [fields[axis].offset for axis in "xyz"],
            "itemsize": message.point_step,
        }
    )
    rows = message.data.reshape(message.height, message.row_step)
    points = np.ascontiguousarray(rows[:, : message.width * message.point_step]).view(dtype)
    return np.stack([points[axis].ravel() for axis in "xyz"], axis=-1).astype(np.float64)


def _pose(transforms: Transforms, source: str, target: str) -> Float64Array:
    """What takes points of one frame to another: (4, 4)."""
    of_source, of_target = _above(transforms, source), _above(transforms, target)
    shared = next((frame for frame in of_source if frame in of_target), None)
    if shared is None:
        problem = f"/tf_static does not connect the frames {source} and {target}"
        raise InputError(problem, "give {extrinsics}")
    return np.asarray(np.linalg.inv(of_target[shared]) @ of_source[shared])


def _above(transforms: Transforms, frame: str) -> dict[str, Float64Array]:
    """A frame and those above, with what takes its points to each."""
    poses: dict[str, Float64Array] = {frame: np.eye(4)}
    while frame in transforms and transforms[frame][0] not in poses:
        above, numbers = transforms[frame]
        poses[above] = matrix_of(numbers) @ poses[frame]
        frame = above
    return poses
