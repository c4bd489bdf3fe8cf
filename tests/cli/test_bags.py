"""``batch`` of bags of ROS 2, written and read back by the library that robotics has for it."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.tiny import synthetic_image, write_model
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
HEIGHT, WIDTH, FOCAL_PX = 24, 32, 40.0
PIXELS = synthetic_image(HEIGHT, WIDTH)
TIMES_NS = (7_000_000_123, 7_100_000_456)


def make(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def header(time_ns: int, frame: str = "camera_optical") -> Any:
    sec, nanosec = divmod(time_ns, 10**9)
    stamp = make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def raw_image(time_ns: int, encoding: str = "rgb8", data: Any = PIXELS, padding: int = 0) -> Any:
    rows = np.ascontiguousarray(data).reshape(HEIGHT, -1).view(np.uint8)
    padded = np.pad(rows, ((0, 0), (0, padding)))
    return make(
        "sensor_msgs/msg/Image",
        header=header(time_ns),
        height=HEIGHT,
        width=WIDTH,
        encoding=encoding,
        is_bigendian=0,
        step=padded.shape[1],
        data=padded.ravel(),
    )


def compressed_image(time_ns: int) -> Any:
    data = cv2.imencode(".png", PIXELS[..., ::-1])[1]
    kind = "sensor_msgs/msg/CompressedImage"
    return make(kind, header=header(time_ns), format="png", data=data.ravel())


def camera_info(time_ns: int, focal_px: float = FOCAL_PX, lens: Sequence[float] = ()) -> Any:
    matrix = np.array([focal_px, 0, 15.5, 0, focal_px, 11.5, 0, 0, 1])
    names = ("x_offset", "y_offset", "height", "width")
    roi = make("sensor_msgs/msg/RegionOfInterest", **dict.fromkeys(names, 0), do_rectify=False)
    return make(
        "sensor_msgs/msg/CameraInfo",
        header=header(time_ns),
        height=HEIGHT,
        width=WIDTH,
        distortion_model="plumb_bob",
        d=np.array(lens, np.float64),
        k=matrix,
        r=np.eye(3).ravel(),
        p=np.insert(matrix, [3, 6, 9], 0.0) * [2.0, 1, 1, 1, 1, 2.0, 1, 1, 1, 1, 1, 1],
        binning_x=0,
        binning_y=0,
        roi=roi,
    )


def write_bag(folder: Path, messages: Sequence[tuple[str, int, Any]], plugin: str) -> None:
    with Writer(folder, version=8, storage_plugin=StoragePlugin[plugin]) as bag:
        connections: dict[str, Any] = {}
        for topic, time_ns, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=STORE)
            bag.write(connections[topic], time_ns, STORE.serialize_cdr(message, kind))


def read_bag(path: Path) -> list[tuple[str, int, Any]]:
    with AnyReader([path]) as bag:
        return [(c.topic, t, bag.deserialize(data, c.msgtype)) for c, t, data in bag.messages()]


def camera_messages(images: Sequence[Any], topic: str, info: Any = None) -> list[Any]:
    """Images recorded a millisecond after their stamps, and the camera before each."""
    messages = []
    for time_ns, image in zip(TIMES_NS, images, strict=True):
        if info is not None:
            messages.append((f"{topic.partition('/image')[0]}/camera_info", time_ns, info))
        messages.append((topic, time_ns + 10**6, image))
    return messages


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize(("format_", "encoding"), [("png16", "16UC1"), ("npy", "32FC1")])
def test_depth_and_camera_have_the_stamps_and_frames_of_the_images(
    inside: Cli, plugin: str, format_: str, encoding: str
) -> None:
    images, topic = [*map(raw_image, TIMES_NS)], "/front/image_raw"
    write_bag(inside.folder / "drive", camera_messages(images, topic, camera_info(0)), plugin)
    inside("batch", "drive", "-o", "out", "--format", format_, code=0)
    suffix = "mcap" if plugin == "MCAP" else "db3"
    messages = read_bag(inside.folder / f"out/drive.depth.{suffix}")
    names = ["/front/depth/image", "/front/depth/camera_info"] * 2
    assert [topic for topic, _, _ in messages] == names
    assert [time_ns for _, time_ns, _ in messages[::2]] == [time + 10**6 for time in TIMES_NS]
    for (_, _, depth), (_, _, info), image in zip(
        messages[::2], messages[1::2], images, strict=True
    ):
        assert asdict(depth.header) == asdict(info.header) == asdict(image.header)
        assert (depth.encoding, depth.height, depth.width) == (encoding, HEIGHT, WIDTH)
        assert info.k[0] == FOCAL_PX
        kind = "<u2" if encoding == "16UC1" else "<f4"
        values = depth.data.view(kind).reshape(HEIGHT, WIDTH)
        depth_m = values / 1000 if encoding == "16UC1" else values
        assert depth.step == values.strides[0]
        assert depth_m[0, 0] < 2  # black is near
        assert depth_m[0, -1] > 4
    again = inside("batch", "drive", "-o", "out", "--format", format_, "--json", code=0)
    assert b'"kept": true' in again.stdout


def depth_of(cli: Cli, messages: Sequence[Any], *words: str, code: int = 0) -> Any:
    """Depth of the first image of a bag in metres, (H, W), and what was printed."""
    number = len(list(cli.folder.iterdir()))
    write_bag(cli.folder / f"bag{number}", messages, "MCAP")
    done = cli("batch", f"bag{number}", "-o", f"out{number}", *words, "--format", "npy", code=code)
    if code:
        return None, done.stderr.decode()
    (_, _, message), *_ = read_bag(cli.folder / f"out{number}/bag{number}.depth.mcap")
    return message.data.view("<f4").reshape(HEIGHT, WIDTH), done.stderr.decode()


BGR = np.ascontiguousarray(PIXELS[..., ::-1])
ENCODED = {
    "bgr8": BGR,
    "mono8": PIXELS.max(2),
    "mono16": PIXELS.max(2).astype("<u2") * 257,
}


@pytest.mark.parametrize("encoding", ENCODED)
def test_an_image_of_any_encoding_has_the_same_depth(inside: Cli, encoding: str) -> None:
    def depth_m(image: Any) -> Any:
        return depth_of(inside, camera_messages([image] * 2, "/image"))[0]

    plain, padded = depth_m(raw_image(7)), raw_image(7, encoding, ENCODED[encoding], padding=5)
    np.testing.assert_allclose(depth_m(padded), plain, atol=0.2)  # colours guide edges
    np.testing.assert_array_equal(depth_m(compressed_image(7)), plain)


def test_the_focal_length_is_that_of_camera_info(inside: Cli) -> None:
    write_model(inside.models / "default", camera={"hfov_deg": 60.0})
    images = [raw_image(7)] * 2

    def depth_m(topic: str, info: Any = None, *words: str) -> Any:
        return depth_of(inside, camera_messages(images, topic, info), *words)[0]

    plain = depth_m("/a/image_raw", camera_info(7))
    double = depth_m("/a/image_raw", camera_info(7, 2 * FOCAL_PX))
    np.testing.assert_allclose(double, 2 * plain, rtol=1e-4)
    rectified = depth_m("/a/image_rect", camera_info(7))  # by P, which has twice the fx
    assert np.median(rectified / plain) == pytest.approx(2, rel=1e-3)
    by_option = depth_m("/a/image_raw", camera_info(7), "--focal-px", str(3 * FOCAL_PX))
    np.testing.assert_allclose(by_option, 3 * plain, rtol=1e-4)
    assert depth_m("/a/image_raw", camera_info(7, 0.0)).shape == (HEIGHT, WIDTH)  # uncalibrated
    lens = camera_messages(images, "/a/image_raw", camera_info(7, lens=(0.1, 0, 0, 0, 0)))
    assert "distortion" in depth_of(inside, lens)[1]


def test_of_several_topics_one_is_named(inside: Cli) -> None:
    messages = camera_messages([raw_image(7)] * 2, "/left/image_raw")
    messages += camera_messages([compressed_image(8)] * 2, "/right/image_raw/compressed")
    _, printed = depth_of(inside, messages, code=1)
    assert "/left/image_raw, /right/image_raw/compressed" in printed
    assert "--topic" in printed
    assert depth_of(inside, messages, "--topic", "/left/image_raw")[0].shape == (HEIGHT, WIDTH)
    assert "/elsewhere" not in depth_of(inside, messages, "--topic", "/elsewhere", code=1)[1]


@pytest.mark.parametrize(
    "words", [("--format", "exr"), ("--sidecar",), ("--png-scale", "256"), ("--png-inverse",)]
)
def test_what_a_bag_cannot_hold_is_refused(inside: Cli, words: tuple[str, ...]) -> None:
    write_bag(inside.folder / "drive", camera_messages([raw_image(7)] * 2, "/image"), "MCAP")
    inside("batch", "drive", "-o", "out", *words, code=1)
    assert not list((inside.folder / "out").glob("*.mcap"))


def test_a_damaged_bag_and_an_unknown_encoding_fail(inside: Cli) -> None:
    (inside.folder / "drive.mcap").write_bytes(b"\x89MCAP0\r\n damaged")
    assert b"drive.mcap" in inside("batch", "drive.mcap", "-o", "out", code=1).stderr
    _, printed = depth_of(inside, camera_messages([raw_image(7, "16UC1")] * 2, "/a/b"), code=1)
    assert "16UC1" in printed


#: what takes points of the lidar, x forward and z up, to the camera
LIDAR_TO_CAMERA = np.array([[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, 0.3], [0, 0, 0, 1.0]])


def transform(above: str, frame: str, turn: Any, place: Any) -> Any:
    numbers = dict(zip("xyzw", map(float, turn), strict=True))
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=header(0, above),
        child_frame_id=frame,
        transform=make(
            "geometry_msgs/msg/Transform",
            translation=make("geometry_msgs/msg/Vector3", **dict(zip("xyz", place, strict=True))),
            rotation=make("geometry_msgs/msg/Quaternion", **numbers),
        ),
    )


def tf_static() -> Any:
    """The lidar above the base, whose points the camera below it takes by LIDAR_TO_CAMERA."""
    turn = (-0.5, 0.5, -0.5, 0.5)  # of the camera's axes in those of the base
    place = -LIDAR_TO_CAMERA[:3, :3].T @ LIDAR_TO_CAMERA[:3, 3]
    poses = [
        transform("base", "lidar", (0, 0, 0, 1), (1.0, 2.0, 3.0)),
        transform("base", "camera_link", (0, 0, 0, 1), place + np.array([1.0, 2, 3])),
        transform("camera_link", "camera_optical", turn, (0.0, 0.0, 0.0)),
    ]
    return make("tf2_msgs/msg/TFMessage", transforms=poses)


def cloud(time_ns: int, depth_m: Any) -> Any:
    """Every fourth pixel of a depth map as a lidar sees it, with an intensity between."""
    y, x = np.mgrid[:HEIGHT:4, :WIDTH:4].reshape(2, -1)
    z = depth_m[y, x]
    xyz1 = np.stack([(x - 15.5) * z / FOCAL_PX, (y - 11.5) * z / FOCAL_PX, z, np.ones_like(z)])
    points = np.zeros(len(z), [("x", "<f4"), ("i", "<u2"), ("y", "<f4"), ("z", "<f4")])
    for axis, values in zip("xyz", np.linalg.inv(LIDAR_TO_CAMERA) @ xyz1, strict=False):
        points[axis] = values
    kinds = {"f": 7, "u": 4}
    fields = [
        make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=points.dtype.fields[name][1],
            datatype=kinds[points.dtype[name].kind],
            count=1,
        )
        for name in points.dtype.names
    ]
    return make(
        "sensor_msgs/msg/PointCloud2",
        header=header(time_ns, "lidar"),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=points.itemsize,
        row_step=points.nbytes,
        data=points.view(np.uint8),
        is_dense=True,
    )


def depth_image(time_ns: int, depth_m: Any, frame: str = "camera_optical") -> Any:
    message = raw_image(time_ns, "16UC1", np.rint(depth_m * 1000).astype("<u2"))
    message.header.frame_id = frame
    return message


def test_known_depth_is_that_of_a_topic(inside: Cli) -> None:
    images = camera_messages([*map(raw_image, TIMES_NS)], "/front/image_raw", camera_info(7))
    plain, _ = depth_of(inside, images)
    late, near = TIMES_NS[0] + 40_000_000, 1.5 * plain
    lidar = [("/points", late, cloud(late, near)), ("/tf_static", 5, tf_static())]
    words = ("--anchors", "topic:/points", "--anchors-fit", "global", "--topic", "/front/image_raw")
    fitted, _ = depth_of(inside, images + lidar, *words)
    np.testing.assert_allclose(fitted, near, rtol=0.01)

    _, printed = depth_of(inside, images + lidar[:1], *words, code=1)
    assert "/tf_static does not connect the frames lidar and camera_optical" in printed
    assert "--extrinsics" in printed
    np.savetxt(inside.folder / "pose.txt", LIDAR_TO_CAMERA)
    fitted, _ = depth_of(inside, images + lidar[:1], *words, "--extrinsics", "pose.txt")
    np.testing.assert_allclose(fitted, near, rtol=0.01)

    words = (words[0], "topic:/depth", *words[2:])
    maps = [("/depth", late, depth_image(late, near))]
    fitted, _ = depth_of(inside, images + maps, *words)
    np.testing.assert_allclose(fitted, near, rtol=0.01)
    maps = [("/depth", late, depth_image(late, near, "ir"))]
    assert "is of the frame ir" in depth_of(inside, images + maps, *words, code=1)[1]


def test_an_image_without_known_depth_near_its_time_is_not_fitted(inside: Cli) -> None:
    images = camera_messages([*map(raw_image, TIMES_NS)], "/image", camera_info(7))
    plain, _ = depth_of(inside, images)
    late = TIMES_NS[1] + 90_000_000  # 190 ms after the first image
    maps = [("/depth", late, depth_image(late, 2 * plain))]
    words = ("--anchors", "topic:/depth", "--topic", "/image")
    depth_m, printed = depth_of(inside, images + maps, *words)
    np.testing.assert_allclose(depth_m, plain, rtol=1e-5)
    assert "no message of /depth within 0.1 s" in printed
    other = (*words[:1], "topic:/other", *words[2:])
    assert "no topic /other" in depth_of(inside, images + maps, *other, code=1)[1]


def test_a_topic_is_no_known_depth_of_an_image_file(inside: Cli) -> None:
    done = inside("predict", "a.png", "--anchors", "topic:/depth", code=1)
    assert b"bag" in done.stderr


def test_scale_and_kind_are_not_for_topics(inside: Cli) -> None:
    """REP 118 states both; they would have no effect."""
    for words in (("--anchors-scale", "5000"), ("--anchors-kind", "distance")):
        done = inside("batch", "drive", "-o", "out", "--anchors", "topic:/depth", *words)
        assert (done.returncode, words[0].encode() in done.stderr) == (2, True)
