"""EXR images: their names, colours and windows."""

import dataclasses
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import OpenEXR
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
from helpers.requests import predict_request, video_request
from helpers.tiny import write_image, write_model
from helpers.videos import encode, flat_frames
from helpers.watched import Watched

import depthcli
from depthcli.core.camera import Anchor, Intrinsics, focal_px_of_hfov
from depthcli.errors import InputError, OutputError
from depthcli.inference.loading import SessionLoader
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.images.read import read_image
from depthcli.io.manifest import OK
from depthcli.io.stored.metadata import camera_text
from depthcli.jobs.batch.plan import plan_files, plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.jobs.image import FailedInput
from depthcli.jobs.predict import PredictResult, predict
from depthcli.jobs.video.plan import VideoResult, VideoSettings, video_destination
from depthcli.jobs.video.run import video
from depthcli.video.depth_video import DepthVideo
from depthcli.video.formats import VideoFormat
from depthcli.video.source import VideoSource, open_frames

WINDOWS = pytest.mark.parametrize("data", [OVERSCAN, CROP, MIXED, DISPLAY])


@pytest.fixture
def loader(tmp_path: Path) -> SessionLoader:
    return SessionLoader(write_model(tmp_path / "model", camera={"hfov_deg": 60.0}), "cpu")


def predicted(path: Path, loader: SessionLoader, *formats: Format, **more: Any) -> PredictResult:
    request = predict_request([path], f"{path.parent}/out/", formats, model=loader, **more)
    (done,) = predict(request)
    if isinstance(done, FailedInput):
        raise done.error
    return done


@WINDOWS
def test_its_depth_is_that_of_a_frame(data: Box, tmp_path: Path, loader: SessionLoader) -> None:
    plate = write_plate(tmp_path / "in", 1, data, aspect=2)
    frames = (VideoFormat.EXR, VideoFormat.NPY)
    video(video_request(f"{plate.parent}/plate.%d.exr", f"{tmp_path}/v/", frames, model=loader))
    done = predicted(plate, loader, Format.EXR, Format.NPY)
    *expected, values = written(tmp_path / "v" / "plate.depth.000001.exr")
    path = plate.parent / "out" / "plate.1.depth.exr"
    *header, stored = written(path)
    assert header == expected == [data, DISPLAY, 2]
    assert np.isfinite(stored).all()
    np.testing.assert_array_equal(stored, values)
    depth = np.load(plate.parent / "out" / "plate.1.depth.npy")
    np.testing.assert_array_equal(depth, np.load(tmp_path / "v" / "plate.depth.000001.npy"))
    np.testing.assert_array_equal(done.depth.values, depth)
    np.testing.assert_array_equal(read_stored_depth(path).displayed.values, depth)
    assert done.depth.provenance.pixel_aspect == 2


@WINDOWS
def test_anchors_are_in_the_display_window(
    data: Box, tmp_path: Path, loader: SessionLoader
) -> None:
    plate = write_plate(tmp_path, 1, data)
    anchors = (Anchor(20, 20, 3.5),)
    done = predicted(plate, loader, Format.EXR, anchors=anchors)
    assert done.depth.values[20, 20] == pytest.approx(3.5)
    assert done.depth.provenance.anchors == anchors
    *_, stored = written(tmp_path / "out" / "plate.1.depth.exr")
    assert stored.shape == size_of(data)
    assert stored[DISPLAY[1] + 20 - data[1], DISPLAY[0] + 20 - data[0]] == pytest.approx(3.5)
    outside = (Anchor(64, 20, 3.5),)
    with pytest.raises(InputError):
        predicted(plate, loader, Format.EXR, anchors=outside)


def test_python_reads_it(tmp_path: Path, loader: SessionLoader) -> None:
    plate = write_plate(tmp_path, 1, MIXED)
    done = predicted(plate, loader, Format.EXR, Format.NPY)
    model = depthcli.load_model(loader.load().model.path.parent, provider="cpu")
    maps = [
        model.predict(plate),
        model.predict(plate.read_bytes()),
        model.predict(depthcli.read_image(plate)),
        *model.predict_many([plate]),
    ]
    for depth in maps:
        np.testing.assert_array_equal(depth.values, done.depth.values)
        assert (depth.frame.height, depth.frame.width) == size_of(DISPLAY)
    maps[0].save(tmp_path / "api.exr")
    common = (DISPLAY[0], MIXED[1], MIXED[2], DISPLAY[3])
    *windows, aspect, stored = written(tmp_path / "api.exr")
    assert (*windows, aspect) == (common, DISPLAY, 1)
    np.testing.assert_array_equal(stored, done.depth.values[inside(common, DISPLAY)])


@pytest.mark.parametrize("data", [CROP, MIXED, (100, 50, 100, 50)])
def test_an_image_is_mirrored_outside_its_data_window(data: Box, tmp_path: Path) -> None:
    frame = read_image(write_plate(tmp_path, 1, data))
    assert frame.windows is not None
    whole = frame.windows.pixels
    whole_box = (whole.left, whole.top, whole.right - 1, whole.bottom - 1)
    rows, columns = inside(data, whole_box)
    around = [
        (at.start, size - at.stop)
        for at, size in zip((rows, columns), frame.pixels.shape, strict=False)
    ]
    expected = np.pad(frame.pixels[rows, columns], [*around, (0, 0)], "symmetric")
    np.testing.assert_array_equal(frame.pixels, expected)
    assert expected.max() > 0


def test_its_size_is_limited_before_its_pixels_are_read(tmp_path: Path) -> None:
    plate = write_plate(tmp_path, 1, OVERSCAN)
    plate.write_bytes(plate.read_bytes()[:1000])  # without most of its pixels
    for name, data in ((str(plate), None), ("standard input", plate.read_bytes())):
        path = None if data else plate
        with pytest.raises(InputError, match=rf"{name} claims 80×54 pixels, more than 4,000; rai"):
            read_image(path, data, max_pixels=4000)
        with pytest.raises(InputError):
            read_image(path, data)


def test_windows_far_apart_are_refused(tmp_path: Path) -> None:
    plate = write_plate(tmp_path, 1, (0, 0, 9, 9), (1_000_000, 1_000_000, 1_000_009, 1_000_009))
    with pytest.raises(InputError):
        read_image(plate)


def test_exr_without_image_channels_is_refused(tmp_path: Path, loader: SessionLoader) -> None:
    plate = write_plate(tmp_path, 1, DISPLAY)
    predicted(plate, loader, Format.EXR)
    own = tmp_path / "out" / "plate.1.depth.exr"
    for path, data in ((own, None), (None, own.read_bytes())):
        with pytest.raises(InputError):
            read_image(path, data)
    header = {"type": OpenEXR.scanlineimage}
    depth = tmp_path / "z.exr"
    OpenEXR.File(header, {"Z": np.ones((8, 8), np.float32)}).write(str(depth))
    with pytest.raises(InputError, match=r"z\.exr holds no image"):
        read_image(depth)


def test_a_plate_outside_the_display_window_has_no_depth(
    tmp_path: Path, loader: SessionLoader
) -> None:
    plate = write_plate(tmp_path, 1, (300, 300, 309, 309))
    with pytest.raises(OutputError):
        predicted(plate, loader, Format.PREVIEW)
    done = predicted(plate, loader, Format.EXR)
    assert np.isnan(done.depth.values).all()
    assert np.isfinite(written(tmp_path / "out" / "plate.1.depth.exr")[3]).all()
    assert np.isnan(
        read_stored_depth(tmp_path / "out" / "plate.1.depth.exr").displayed.values
    ).all()


def test_a_batch_reads_those_of_a_list_alone(tmp_path: Path, loader: SessionLoader) -> None:
    root, out = tmp_path / "in", tmp_path / "batch"
    plate = write_plate(root, 1, MIXED)
    done = predicted(plate, loader, Format.EXR, anchors=(Anchor(20, 20, 3.5),))
    moved = (root / "out" / "plate.1.depth.exr").rename(root / "own.exr")
    write_image(root / "room.png")
    whole = plan_folder(str(root), str(out))
    assert [file.name for file in whole.inputs] == ["room.png"]
    assert {(file.name, file.reason) for file in whole.skipped} == {
        ("plate.1.exr", ".exr"),
        ("own.exr", ".exr"),
    }
    plan = plan_files([plate.name, moved.name], "mine", str(root), str(out))
    options = BatchOptions((Format.EXR, Format.NPY), anchors=(Anchor(20, 20, 3.5),))
    assert [file.name for file in plan.skipped] == ["own.exr"]
    (result,) = Batch(BatchRequest(plan, options, loader))
    assert result.row.status == OK
    assert result.row.camera == camera_text(done.depth)
    np.testing.assert_array_equal(np.load(out / "plate.1.depth.npy"), done.depth.values)
    assert written(out / "plate.1.depth.exr")[:2] == (MIXED, DISPLAY)


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
def test_the_field_of_view_is_that_of_the_display_window(
    data: Box, tmp_path: Path, depth_of: Callable[..., VideoResult]
) -> None:
    write_plate(tmp_path / "in", 1, data)
    given_px = focal_px_of_hfov(40, 64)
    done = depth_of(VideoFormat.EXR, camera=Intrinsics(hfov_deg=40, centre_px=(30.5, 22.25)))
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
    headers = [written(path) for path in paths]
    assert [display for _, display, _, _ in headers] == [DISPLAY] * 4
    assert [data for data, *_ in headers] == [
        MIXED,
        CROP,
        (92, 50, 163, 99),  # the overscan that the first plate has, too
        (100, 50, 100, 50),  # a file has to have a pixel
    ]
    assert np.isnan(headers[3][3]).all()


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
    frames = tmp_path / "a.mp4", flat_frames(range(2)), Fraction(25), "mpeg4", "yuv420p"
    path = encode(*frames, matrix=matrix, aspect=stated)
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
