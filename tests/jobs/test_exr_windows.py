"""Plates with overscan, crops and non-square pixels: their depth lines up with them."""

import dataclasses
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from helpers.plates import (
    CROP,
    DISPLAY,
    MIXED,
    OVERSCAN,
    Box,
    inside,
    size_of,
    write_plate,
    written,
)
from helpers.requests import video_request
from helpers.tiny import write_model
from helpers.videos import flat_frames
from helpers.watched import Watched

from depthcli.core.camera import Intrinsics, focal_px_of_hfov
from depthcli.inference.loading import SessionLoader
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.formats.table import WriterOptions
from depthcli.jobs.video.plan import VideoResult, VideoSettings, video_destination
from depthcli.jobs.video.run import video
from depthcli.video.depth_video import DepthVideo
from depthcli.video.formats import VideoFormat
from depthcli.video.source import VideoSource, open_frames

WINDOWS = pytest.mark.parametrize("data", [OVERSCAN, CROP, MIXED, DISPLAY])


@pytest.fixture
def loader(tmp_path: Path) -> SessionLoader:
    return SessionLoader(write_model(tmp_path / "model", camera={"hfov_deg": 60.0}), "cpu")


@pytest.fixture
def depth_of(tmp_path: Path, loader: SessionLoader) -> Callable[..., VideoResult]:
    """Predict the plates in the folder ``in``, into the folder ``out``."""

    def predicted(*formats: VideoFormat, **settings: Any) -> VideoResult:
        chosen = VideoSettings(**settings)
        request = video_request(
            f"{tmp_path}/in/plate.%d.exr", f"{tmp_path}/out/", formats, model=loader
        )
        return video(dataclasses.replace(request, settings=chosen))

    return predicted


@WINDOWS
def test_depth_has_the_windows_and_the_pixels_of_its_plate(
    data: Box, tmp_path: Path, depth_of: Callable[..., VideoResult]
) -> None:
    write_plate(tmp_path / "in", 1001, data, aspect=2)
    done = depth_of(VideoFormat.EXR, VideoFormat.NPY)
    assert (done.depth.height, done.depth.width) == size_of(DISPLAY)
    out, name = tmp_path / "out", "plate.depth.001001"
    *windows, aspect, stored = written(out / f"{name}.exr")
    assert (*windows, aspect) == (data, DISPLAY, 2)
    assert stored.shape == size_of(data)
    assert np.isfinite(stored).all()
    shown = np.load(out / f"{name}.npy")
    np.testing.assert_array_equal(read_stored_depth(out / f"{name}.exr").displayed.values, shown)
    left, top, right, bottom = (
        pick(a, b) for pick, a, b in zip((max, max, min, min), data, DISPLAY, strict=True)
    )
    common = (left, top, right, bottom)
    np.testing.assert_array_equal(stored[inside(common, data)], shown[inside(common, DISPLAY)])
    hole = np.ones(shown.shape, bool)
    hole[inside(common, DISPLAY)] = False
    assert np.isnan(shown[hole]).all()


def test_overscan_is_seen_and_is_as_deep_as_its_pixels_say(
    tmp_path: Path, depth_of: Callable[..., VideoResult]
) -> None:
    """The tiny network takes bright for far, and the plate gets brighter to the right."""
    write_plate(tmp_path / "in", 1, OVERSCAN)
    depth_of(VideoFormat.EXR)
    stored = written(tmp_path / "out" / "plate.depth.000001.exr")[3]
    assert (np.diff(stored[:, ::20]) > 0).all()


@WINDOWS
def test_the_field_of_view_is_that_of_the_display_window(
    data: Box, tmp_path: Path, depth_of: Callable[..., VideoResult]
) -> None:
    write_plate(tmp_path / "in", 1, data)
    given_px = focal_px_of_hfov(40, 64)
    done = depth_of(
        VideoFormat.EXR,
        camera=Intrinsics(hfov_deg=40, centre_px=(30.5, 22.25)),
    )
    assert done.depth.provenance.focal_px == pytest.approx(given_px)
    facts = read_metadata(tmp_path / "out" / "plate.depth.000001.exr")
    assert float(facts["focal_px"]) == pytest.approx(given_px, rel=1e-5)
    assert facts["camera"] == "hfov 40.0° (given)"
    assert facts["centre_px"] == "30.5,22.25"
    assumed = depth_of(VideoFormat.EXR).depth.provenance
    assert assumed.focal_px == pytest.approx(focal_px_of_hfov(60, 64))


def test_formats_without_windows_show_the_display_window(
    tmp_path: Path, depth_of: Callable[..., VideoResult]
) -> None:
    for number in range(3):
        write_plate(tmp_path / "in", number, OVERSCAN)
    formats = (VideoFormat.MKV, VideoFormat.MP4, VideoFormat.PNG16, VideoFormat.EXR)
    depth_of(*formats, writing=WriterOptions(side_by_side=True))
    out = tmp_path / "out"
    depth = read_stored_depth(out / "plate.depth.000002.exr").displayed.values
    assert depth.shape == size_of(DISPLAY)
    steps = np.rint(depth * 1000).astype(np.uint16)
    np.testing.assert_array_equal(cv2.imread(str(out / "plate.depth.000002.png"), -1), steps)
    np.testing.assert_array_equal(list(DepthVideo(out / "plate.depth.mkv").steps())[2], steps)
    with VideoSource(out / "plate.preview.mp4") as preview:
        assert (preview.width, preview.height) == (2 * 64, 48)
        plate = next(preview.frames()).pixels[:, :64, 0] / np.float32(255)
    with open_frames(tmp_path / "in" / "plate.%d.exr") as source:
        pixels = next(source.frames()).pixels[inside(DISPLAY, OVERSCAN)][..., 0]
    assert np.abs(plate - pixels).mean() < 0.03


def test_overscan_is_smoothed(tmp_path: Path, depth_of: Callable[..., VideoResult]) -> None:
    for number in range(3):
        write_plate(tmp_path / "in", number, OVERSCAN)
    depth_of(VideoFormat.EXR)
    path = tmp_path / "out" / "plate.depth.000002.exr"
    plain = written(path)[3]
    depth_of(VideoFormat.EXR, smooth_s=1.0)
    *windows, _, smoothed = written(path)
    assert windows == [OVERSCAN, DISPLAY]
    assert (smoothed < plain).all()


@pytest.mark.parametrize(
    "formats",
    [
        (VideoFormat.EXR, VideoFormat.MP4),
        (VideoFormat.NPY, VideoFormat.EXR, VideoFormat.MKV),
        (VideoFormat.MKV, VideoFormat.MP4),
    ],
)
@pytest.mark.parametrize("data", [OVERSCAN, MIXED])
def test_a_run_with_overscan_that_was_stopped_goes_on_to_the_same_bytes(
    data: Box, formats: tuple[VideoFormat, ...], tmp_path: Path, loader: SessionLoader
) -> None:
    for number in range(8):
        write_plate(tmp_path / "in", number, data)
    request = video_request(
        f"{tmp_path}/in/plate.%d.exr", f"{tmp_path}/out/", formats, sidecar=True, model=loader
    )
    with pytest.raises(KeyboardInterrupt):
        video(request, Watched(last=3))
    video(request)
    video(
        dataclasses.replace(
            request, destination=video_destination(f"{tmp_path}/whole/", formats, sidecar=True)
        )
    )
    resumed, whole = (
        {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()}
        for name in ("out", "whole")
    )
    assert resumed == whole


def test_each_plate_has_own_windows(tmp_path: Path, depth_of: Callable[..., VideoResult]) -> None:
    elsewhere = (300, 300, 309, 309)
    for number, data in enumerate((MIXED, CROP, OVERSCAN, elsewhere)):
        write_plate(tmp_path / "in", number, data)
    done = depth_of(VideoFormat.EXR, VideoFormat.PNG16)
    (warning,) = done.warnings
    assert warning.startswith("images with more overscan than the first one, which is cut off: 2")
    assert (done.frames, done.problem) == (4, None)
    paths = sorted((tmp_path / "out").glob("*.exr"))
    found = [written(path) for path in paths]
    assert [display for _, display, _, _ in found] == [DISPLAY] * 4
    assert [data for data, *_ in found] == [
        MIXED,
        CROP,
        (92, 50, 163, 99),  # the overscan that the first plate has, too
        (100, 50, 100, 50),  # a file has to have a pixel
    ]
    assert np.isnan(found[3][3]).all()


def test_a_plate_of_another_display_window_ends_the_sequence(
    tmp_path: Path, depth_of: Callable[..., VideoResult]
) -> None:
    write_plate(tmp_path / "in", 0, CROP)
    write_plate(tmp_path / "in", 1, CROP, display=(100, 50, 162, 97))
    done = depth_of(VideoFormat.EXR)
    assert done.frames == 1
    assert "plate.1.exr has another size" in str(done.problem)


@pytest.mark.parametrize(
    ("stated", "matrix", "expected"),
    [
        (Fraction(4, 3), None, 4 / 3),
        (Fraction(4, 3), (0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30), 3 / 4),
        (None, None, 1),
    ],
)
def test_depth_of_an_anamorphic_video_has_its_pixels(
    stated: Fraction | None,
    matrix: tuple[int, ...] | None,
    expected: float,
    tmp_path: Path,
    loader: SessionLoader,
) -> None:
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as output:
        stream = output.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.set_display_matrix(matrix)
        if stated is not None:
            stream.codec_context.sample_aspect_ratio = stated
        for pixels in flat_frames(range(2)):
            output.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, "rgb24")))
        output.mux(stream.encode(None))
    films = (VideoFormat.MP4, VideoFormat.MOV)
    formats = (VideoFormat.EXR, *films)
    video(video_request(path, f"{tmp_path}/out/", formats, model=loader))
    data, display, aspect, stored = written(tmp_path / "out" / "a.depth.000001.exr")
    assert aspect == pytest.approx(expected)
    assert data == display == (0, 0, stored.shape[1] - 1, stored.shape[0] - 1)
    for film in films:
        (found,) = (tmp_path / "out").glob(f"*.{film}")
        with av.open(str(found)) as container:
            stated_pixels = container.streams.video[0].sample_aspect_ratio
        assert float(stated_pixels or 1) == pytest.approx(expected)
