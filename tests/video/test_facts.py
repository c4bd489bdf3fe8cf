"""Facts that a video states about its streams and its camera."""

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from helpers.videos import NTSC, box, encode, flat_frames, with_box, with_track_tag, write_mp4
from PIL import Image

from depthcli.core.options import Eye, Projection, ReadOptions
from depthcli.errors import InputError, UsageError
from depthcli.video.source import VideoSource


def write_streams(path: Path, counts: Sequence[int]) -> Path:
    """A video with several streams, each of one gray level."""
    with av.open(str(path), "w") as output:
        streams = []
        for _ in counts:
            stream = output.add_stream("mpeg4", rate=25)
            stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
            streams.append(stream)
        for number, (stream, count) in enumerate(zip(streams, counts, strict=True)):
            for index, pixels in enumerate(flat_frames([60 * number + 30] * count)):
                frame = av.VideoFrame.from_ndarray(pixels, "rgb24")
                frame.pts, frame.time_base = index, Fraction(1, 25)
                output.mux(stream.encode(frame))
            output.mux(stream.encode(None))
    return path


def read(path: Path, **options: Any) -> tuple[VideoSource, list[Any]]:
    with VideoSource(path, **options) as source:
        return source, list(source.frames())


@pytest.mark.parametrize(
    ("counts", "options", "expected"),
    [
        ((1, 5), {}, 1),  # as in an animated AVIF, whose first stream is the still image
        ((4, 4, 2), {}, 0),
        ((1, 5), {"stream": 0}, 0),
        ((9, 5), {"stream": 1}, 1),
    ],
)
@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
def test_the_stream_with_most_frames_is_read(
    counts: tuple[int, ...], options: dict[str, int], expected: int, suffix: str, tmp_path: Path
) -> None:
    source, frames = read(write_streams(tmp_path / f"a.{suffix}", counts), **options)
    assert len(frames) == counts[expected]
    assert abs(int(frames[0].pixels[9, 9, 0]) - 60 * expected - 30) < 4
    assert ["stream" in warning for warning in source.warnings] == [True] * (not options)


def test_a_stream_that_does_not_exist_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as caught:
        VideoSource(write_streams(tmp_path / "a.mp4", (2, 2)), stream=2)
    assert "2 video streams" in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "value", "focal_35mm", "focal_mm"),
    [
        (21, (13).to_bytes(4), 13, None),  # iPhone
        (21, (27).to_bytes(1), 27, None),
        (77, (24).to_bytes(4), 24, None),
        (23, struct.pack(">f", 26.5), 26.5, None),
        (1, b"50.00mm", 50, None),  # Blackmagic Camera
        (1, b"unknown", None, None),
        (1, b"iPhone 15 Pro back camera 6.765mm f/1.78", None, 6.765),  # of the lens
    ],
)
def test_the_focal_length_of_a_track_is_that_of_its_frames(
    kind: int, value: bytes, focal_35mm: float | None, focal_mm: float | None, tmp_path: Path
) -> None:
    path = write_mp4(tmp_path / "a.mov", flat_frames(range(3)))
    name = "lens_model" if focal_mm else "focal_length.35mm_equivalent"
    name = f"com.apple.quicktime.camera.{name}"
    path.write_bytes(with_track_tag(path.read_bytes(), name, kind, value))
    _, frames = read(path)
    assert [(frame.focal_35mm, frame.focal_mm) for frame in frames] == [(focal_35mm, focal_mm)] * 3


def stereo(
    path: Path, packing: int | None, *, is_stacked: bool = False, size: tuple[int, int] = (64, 64)
) -> Path:
    """H.264 whose left view, the first one, is dark, and the right one bright."""
    views = [np.full((*size, 3), level, np.uint8) for level in (40, 200)]
    frame = np.concatenate(views, axis=0 if is_stacked else 1)
    options = {} if packing is None else {"x264-params": f"frame-packing={packing}"}
    return encode(path, [frame] * 3, NTSC, "libx264", "yuv420p", options=options)


@pytest.mark.parametrize(("packing", "is_stacked"), [(3, False), (4, True), (None, False)])
@pytest.mark.parametrize(("eye", "level"), [(Eye.LEFT, 40), (Eye.RIGHT, 200)])
def test_one_view_of_a_stereo_video_is_read(
    packing: int | None, eye: Eye, level: int, tmp_path: Path, *, is_stacked: bool
) -> None:
    path = stereo(tmp_path / "a.mkv", packing, is_stacked=is_stacked)
    source, frames = read(path, options=ReadOptions(eye=eye))
    assert (source.width, source.height, frames[0].pixels.shape) == (64, 64, (64, 64, 3))
    assert abs(frames[0].pixels.astype(int) - level).max() < 4
    assert len(source.warnings) == (packing is None)


@pytest.mark.parametrize(
    ("packing", "size", "aspect"),
    [(3, (64, 48), 2), (None, (64, 48), 2), (4, (36, 96), 0.5), (3, (64, 96), 1), (4, (64, 96), 1)],
)
def test_views_squeezed_into_the_shape_of_one_image_have_wide_pixels(
    packing: int | None, size: tuple[int, int], aspect: float, tmp_path: Path
) -> None:
    """gkv311/sview#120, BlueSkyDefender/Depth3D#46, nagadomi/nunif#163."""
    path = stereo(tmp_path / "a.mkv", packing, is_stacked=packing == 4, size=size)
    source, frames = read(path, options=ReadOptions(eye=Eye.LEFT))
    assert (frames[0].pixels.shape[:2], frames[0].pixel_aspect) == (size, aspect)
    assert len([text for text in source.warnings if "squeezed" in text]) == (aspect != 1)


def test_an_animated_webp_is_no_single_image(tmp_path: Path) -> None:
    first, second = (Image.new("RGB", (16, 16), level) for level in ("red", "blue"))
    first.save(tmp_path / "a.webp", save_all=True, append_images=[second])
    with pytest.raises(InputError, match="animated WebP"):
        VideoSource(tmp_path / "a.webp")


def test_two_views_in_a_frame_give_a_warning(tmp_path: Path) -> None:
    source, frames = read(stereo(tmp_path / "a.mkv", 3))
    assert frames[0].pixels.shape == (64, 128, 3)
    (warning,) = source.warnings
    assert "eye" in warning
    with pytest.raises(UsageError):
        read(stereo(tmp_path / "b.mkv", 5), options=ReadOptions(eye=Eye.LEFT))  # in turn


@pytest.mark.parametrize("size", [(48, 64), (480, 640)])
@pytest.mark.parametrize(
    "part", [b"%(jpeg)b", b"--frame\r\nContent-Length: %(size)d\r\n\r\n%(jpeg)b\r\n"]
)
def test_motion_jpeg_of_cameras_is_read(size: tuple[int, int], part: bytes, tmp_path: Path) -> None:
    """ESP32-CAM and others store JPEGs one after the other (espressif/esp32-camera#84)."""
    noise = np.random.default_rng(0).integers(0, 255, (*size, 3), np.uint8)
    _, jpeg = cv2.imencode(".jpg", noise)
    data = part % {b"size": jpeg.size, b"jpeg": jpeg.tobytes()}
    (tmp_path / "a.mjpeg").write_bytes(data * 5)
    source, frames = read(tmp_path / "a.mjpeg")
    assert len(frames) == 5
    assert (source.height, source.width) == size


def test_frames_of_a_closed_video_are_an_error(tmp_path: Path) -> None:
    source = VideoSource(write_mp4(tmp_path / "a.mp4", flat_frames(range(20))))
    frames = source.frames()
    next(frames)
    source.close()
    with pytest.raises(UsageError):
        list(frames)


@pytest.mark.parametrize("projection", [None, Projection.EQUIRECTANGULAR])
def test_a_panorama_is_read_as_one_on_request(
    projection: Projection | None, tmp_path: Path
) -> None:
    path = write_mp4(tmp_path / "a.mp4", flat_frames(range(3), 32, 64))
    facts = (
        box(b"svhd", bytes(4), b"test\0"),
        box(b"proj", box(b"prhd", bytes(16)), box(b"equi", bytes(20))),
    )
    parents = b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"mp4v"
    path.write_bytes(with_box(path.read_bytes(), box(b"sv3d", *facts), *parents))
    source, frames = read(path, options=ReadOptions(projection=projection))
    assert frames[0].projection is (projection or Projection.PINHOLE)
    assert len(source.warnings) == (projection is None)


@pytest.mark.parametrize(  # the last in WebM, as stickers are: mpv issue 10304
    ("codec", "pixel_format"), [("png", "rgba"), ("qtrle", "argb"), ("libvpx-vp9", "yuva420p")]
)
def test_transparent_pixels_of_a_video_have_no_depth(
    codec: str, pixel_format: str, tmp_path: Path
) -> None:
    frame = np.full((48, 64, 4), 90, np.uint8)
    frame[..., 3] = 255
    frame[:, 40:] = (255, 255, 255, 0)
    frames = [frame, frame, frame * 0]
    path = tmp_path / ("a.mov" if "rgb" in pixel_format else "a.webm")
    encode(path, frames, Fraction(25), codec, pixel_format)
    source, frames = read(path)
    np.testing.assert_array_equal(frames[0].transparent, frame[..., 3] == 0)
    np.testing.assert_allclose(frames[0].pixels, 90, atol=1)
    assert len(source.warnings) == 1
    assert np.asarray(frames[2].transparent).all()
    source, frames = read(path, options=ReadOptions(ignore_alpha=True))
    assert frames[0].transparent is None
    assert frames[0].pixels[0, 50].min() >= 254


def test_levels_stretch_the_range_of_a_thermal_video(tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(29_000, 30_000, 64).astype(np.uint16), (48, 1))
    path = encode(tmp_path / "a.mkv", [ramp] * 2, NTSC, "ffv1", "gray16le")
    source, frames = read(path)
    assert frames[0].pixels.max() <= 30_000
    (warning,) = source.warnings
    assert "black_level" in warning
    source, frames = read(path, options=ReadOptions(white_level=30_000, black_level=29_000))
    for frame in frames:
        assert (frame.pixels.min(), frame.pixels.max()) == (0, 65535)
    assert source.warnings == ()
