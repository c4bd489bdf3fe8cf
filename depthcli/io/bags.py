"""Bags of ROS 2, in MCAP or SQLite: images and their cameras are read, depth is written."""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import cv2
import numpy as np

from depthcli.core.options import INSTALL_ROS
from depthcli.core.types import AnyArray
from depthcli.errors import DepthcliError, InputError
from depthcli.io.archives import Member, Write
from depthcli.io.calibration import camera_of_ros
from depthcli.io.formats.table import Format
from depthcli.io.storage.atomic import temporary_folder

_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_INFO, CLOUD = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/PointCloud2"
_WITHIN_NS = 100_000_000  # of an image, the scan of a lidar that turns ten times a second
DEPTH_ENCODINGS = {Format.PNG16: "16UC1", Format.NPY: "32FC1"}
"""Encodings of depth in REP 118, millimetres and metres, by the formats that choose them."""
#: channels, type, and OpenCV's conversion to RGB
_ENCODINGS: dict[str, tuple[int, str, int | None]] = {
    **dict.fromkeys(("mono8", "8UC1"), (1, "u1", None)),
    "mono16": (1, "u2", None),
    "rgb8": (3, "u1", None),
    **dict.fromkeys(("bgr8", "8UC3"), (3, "u1", cv2.COLOR_BGR2RGB)),
    "rgba8": (4, "u1", cv2.COLOR_RGBA2RGB),
    **dict.fromkeys(("bgra8", "8UC4"), (4, "u1", cv2.COLOR_BGRA2RGB)),
    "bayer_rggb8": (1, "u1", cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, "u1", cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, "u1", cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, "u1", cv2.COLOR_BayerGRBG2RGB),
    **dict.fromkeys(("yuv422", "uyvy"), (2, "u1", cv2.COLOR_YUV2RGB_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (2, "u1", cv2.COLOR_YUV2RGB_YUY2)),
}


Transforms: TypeAlias = Mapping[str, tuple[str, tuple[float, ...]]]
"""Of frames by name: the frame above, and x y z qx qy qz qw of what takes points to that."""


class Origin(NamedTuple):
    """The message of an image, whose time and frame its depth has."""

    camera_name: str  #: namespace of its topic, such as ``/camera``
    time_ns: int  #: when it was recorded
    header: Any  #: with stamp and frame id
    info: Any  #: its ``CameraInfo``; None if there is none
    #: the nearest message with known depth, a cloud or a depth image; None if none is near
    sensor: Any
    transforms: Transforms  #: those of the bag that do not change


def bag_members(
    path: Path, topic: str | None = None, sensor: str | None = None
) -> Iterator[Member]:
    """The images of a topic, by default of the only one, in the order of their recording.

    Their camera is the ``camera_info`` beside the topic, or the only one of the bag; known depth is
    that of the topic ``sensor``.

    Raises:
        InputError: the bag cannot be read, or has no such images or sensor.
    """
    with _opened(path) as bag:
        names = {c.topic for c in bag.connections if c.msgtype in {_IMAGE, _COMPRESSED}}
        names = {name for name in names if not name.endswith("/compressedDepth")}
        if (topic or len(names) != 1) and topic not in names:
            listed = ", ".join(sorted(names)) or "none"
            raise InputError(f"topics with images in {path}: {listed}", "name one with {topic}")
        topic = topic or min(names)
        camera_name, _, last = topic.removesuffix("/compressed").rpartition("/")
        infos = [c for c in bag.connections if c.msgtype == _INFO]
        beside = [c for c in infos if c.topic == f"{camera_name}/camera_info"]
        infos = beside or (infos if len(infos) == 1 else [])
        images = [c for c in bag.connections if c.topic == topic]
        # The first is that of earlier images, too.
        info, _ = next(_messages(bag, infos), (None, 0))
        nearest, transforms = _sensor_reader(bag, sensor), _transforms(bag)
        for message, time_ns in _messages(bag, [*infos, *images]):
            if message.__msgtype__ == _INFO:
                info = message
                continue
            header, stamp = message.header, message.header.stamp
            origin = Origin(camera_name, time_ns, header, info, nearest(message), transforms)
            camera = None
            if info is not None and info.k[0]:  # else it is not calibrated
                camera = camera_of_ros(asdict(info), path, rectified="rect" in last)
            yield Member(f"{stamp.sec}.{stamp.nanosec:09}", _encoded(message), camera, origin)


def _messages(bag: Any, connections: Sequence[Any], at_ns: int | None = None) -> Iterator[Any]:  # noqa: ANN401
    """Messages and the times they were recorded at, in order; of all times, or of one."""
    if connections:  # the library takes none for all of them
        for connection, time_ns, data in bag.messages(connections, at_ns, at_ns and at_ns + 1):
            yield bag.deserialize(data, connection.msgtype), time_ns


def _sensor_reader(bag: Any, topic: str | None) -> Callable[[Any], Any]:  # noqa: ANN401
    """A function that gives the message of a topic nearest to another; None if none is near."""
    connections = [c for c in bag.connections if c.topic == topic]
    if topic and not connections:
        others = {c.topic for c in bag.connections if c.msgtype in {CLOUD, _IMAGE}}
        raise InputError(f"no topic {topic}", f"choose from {', '.join(sorted(others))}")
    recorded = [(_time_ns(each), time_ns) for each, time_ns in _messages(bag, connections)]

    def nearest(message: Any) -> Any:  # noqa: ANN401
        at_ns = _time_ns(message)
        stamp_ns, time_ns = min(recorded, key=lambda each: abs(each[0] - at_ns), default=(0, 0))
        if not recorded or abs(stamp_ns - at_ns) > _WITHIN_NS:
            return None
        return next(_messages(bag, connections, time_ns))[0]

    return nearest


def _time_ns(message: Any) -> int:  # noqa: ANN401
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def _transforms(bag: Any) -> Transforms:  # noqa: ANN401
    """The transforms of ``/tf_static``."""
    transforms: dict[str, tuple[str, tuple[float, ...]]] = {}
    for message, _ in _messages(bag, [c for c in bag.connections if c.topic == "/tf_static"]):
        for each in message.transforms:
            place, turn = each.transform.translation, each.transform.rotation
            numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
            transforms[each.child_frame_id] = each.header.frame_id, numbers
    return transforms


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A reader of a bag; what the library raises becomes one kind of error."""
    store = _types()  # which bags before Iron do not define
    from rosbags.highlevel import AnyReader  # noqa: PLC0415

    try:
        with AnyReader([path], default_typestore=store) as bag:
            yield bag
    except DepthcliError:
        raise
    except Exception as error:  # of many types
        raise InputError(f"{path} is not a bag that can be read: {error}") from error


def _types() -> Any:  # noqa: ANN401
    """The types of messages in ROS 2 Humble."""
    try:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - an extra
    except ImportError:
        raise InputError("bags need rosbags", f"install it: {INSTALL_ROS}") from None
    return get_typestore(Stores.ROS2_HUMBLE)


def _encoded(message: Any) -> bytes:  # noqa: ANN401 - of a type that the bag defines
    """The file of a compressed image, or a PGM or PPM of a raw one."""
    if message.__msgtype__ == _COMPRESSED:
        return bytes(message.data)
    if message.encoding not in _ENCODINGS:
        raise InputError(f"images of encoding {message.encoding} are not read", "use {topic}")
    channels, kind, conversion = _ENCODINGS[message.encoding]
    pixels = pixels_of(message, kind, channels)
    height, width, _ = pixels.shape
    pixels = pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    form = b"P6" if pixels.shape[-1] == 3 else b"P5"  # noqa: PLR2004 - RGB
    head = b"%s %d %d %d\n" % (form, width, height, 2 ** (8 * pixels.itemsize) - 1)
    return head + pixels.astype(pixels.dtype.newbyteorder(">")).tobytes()


def pixels_of(message: Any, kind: str, channels: int = 1) -> AnyArray:  # noqa: ANN401
    """The pixels of a raw image, (H, W, channels), without the padding of its rows."""
    width, height = message.width, message.height
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    rows = message.data.reshape(height, message.step)[:, : width * channels * dtype.itemsize]
    return np.ascontiguousarray(rows).view(dtype).reshape(height, width, channels)


@contextmanager
def bag_writer(path: Path, formats: tuple[Format, ...]) -> Iterator[Write]:
    """Write a bag, MCAP or SQLite by its suffix, of depth and ``CameraInfo``.

    The topics are ``depth/image`` and ``depth/camera_info`` beside that of the images, whose stamps
    and frame ids they have.

    Raises:
        InputError: a bag does not hold these formats.
    """
    if len(formats) != 1 or formats[0] not in DEPTH_ENCODINGS:
        problem = "a bag holds depth in millimetres (png16) or in metres (npy)"
        raise InputError(problem, "give {format} one of them")
    store, connections = _types(), dict[str, Any]()
    from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: PLC0415

    plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
    with temporary_folder() as folder:  # the library writes a folder
        with Writer(folder / "depth", version=8, storage_plugin=plugin) as bag:

            def send(origin: Origin, name: str, message: Any) -> None:  # noqa: ANN401
                topic, kind = f"{origin.camera_name}/depth/{name}", message.__msgtype__
                if topic not in connections:
                    connections[topic] = bag.add_connection(topic, kind, typestore=store)
                data = store.serialize_cdr(message, kind)
                bag.write(connections[topic], origin.time_ns, data)

            def write(member: Member, files: Mapping[Format, bytes]) -> None:
                for format_, data in files.items():
                    depth, origin = _depth(format_, data), member.origin
                    height, width = depth.shape
                    message = store.types[_IMAGE](
                        header=origin.header,
                        height=height,
                        width=width,
                        encoding=DEPTH_ENCODINGS[format_],
                        is_bigendian=0,
                        step=width * depth.itemsize,
                        data=depth.view(np.uint8).ravel(),
                    )
                    send(origin, "image", message)
                    if origin.info is not None:
                        send(origin, "camera_info", replace(origin.info, header=origin.header))

            yield write
        (file,) = (folder / "depth").glob(f"*{path.suffix}")
        shutil.copyfile(file, path)


def _depth(format_: Format, data: bytes) -> Any:  # noqa: ANN401 - uint16 or float32
    """(H, W) uint16 millimetres or float32 metres of a file, of little-endian numbers."""
    if format_ is Format.PNG16:
        steps: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        return steps.astype("<u2")
    return np.ascontiguousarray(np.load(BytesIO(data)), "<f4")
