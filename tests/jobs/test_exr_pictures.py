"""A single EXR picture: its depth is that of the same frame of a sequence."""

import errno
import pathlib
from io import BytesIO
from pathlib import Path
from typing import Any

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
from helpers.stores import Bucket
from helpers.tiny import write_model, write_picture

import depthcli
from depthcli.core.camera import Anchor
from depthcli.errors import InputError, OutputError
from depthcli.inference.loading import SessionLoader
from depthcli.io.depth.metadata import camera_text
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.images.read import read_image
from depthcli.io.manifest import OK
from depthcli.jobs.batch.plan import plan_files, plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.jobs.output_names import output_bases
from depthcli.jobs.outputs import plan_outputs
from depthcli.jobs.predict import PictureResult, picture_destination, predict
from depthcli.jobs.video.run import video
from depthcli.jobs.write import FailedInput
from depthcli.video.formats import VideoFormat

WINDOWS = pytest.mark.parametrize("data", [OVERSCAN, CROP, MIXED, DISPLAY])


@pytest.fixture
def loader(tmp_path: Path) -> SessionLoader:
    return SessionLoader(write_model(tmp_path / "model", camera={"hfov_deg": 60.0}), "cpu")


def predicted(path: Path, loader: SessionLoader, *formats: Format, **more: Any) -> PictureResult:
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
    *found, stored = written(plate.parent / "out" / "plate.1.depth.exr")
    assert found == expected == [data, DISPLAY, 2]
    np.testing.assert_array_equal(stored, values)
    shown = np.load(plate.parent / "out" / "plate.1.depth.npy")
    np.testing.assert_array_equal(shown, np.load(tmp_path / "v" / "plate.depth.000001.npy"))
    np.testing.assert_array_equal(done.depth.values, shown)
    assert done.depth.provenance.pixel_aspect == 2


def test_its_other_outputs_have_the_display_window(tmp_path: Path, loader: SessionLoader) -> None:
    plate = write_plate(tmp_path, 1, OVERSCAN)
    looks = WriterOptions(side_by_side=True)
    predicted(plate, loader, Format.PNG16, Format.PREVIEW, Format.PLY, writing=looks)
    height, width = size_of(DISPLAY)
    assert cv2.imread(str(tmp_path / "out" / "plate.1.depth.png"), -1).shape == (height, width)
    preview = cv2.imread(str(tmp_path / "out" / "plate.1.preview.png"))
    assert preview.shape == (height, 2 * width, 3)
    cloud = (tmp_path / "out" / "plate.1.ply").read_bytes()
    assert f"element vertex {height * width}\n".encode() in cloud


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


def test_it_can_come_through_a_pipe(tmp_path: Path, loader: SessionLoader) -> None:
    plate = write_plate(tmp_path, 1, MIXED, aspect=2)
    predicted(plate, loader, Format.EXR)
    output = BytesIO()
    stdin = BytesIO(plate.read_bytes())
    request = predict_request(["-"], "-", (Format.EXR,), model=loader, stdin=stdin, stdout=output)
    (done,) = predict(request)
    assert isinstance(done, PictureResult)
    assert output.getvalue() == (tmp_path / "out" / "plate.1.depth.exr").read_bytes()


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


def test_a_store_has_plates_too(tmp_path: Path, bucket: Bucket) -> None:
    plate = write_plate(tmp_path, 1, MIXED)
    uri = bucket.put("in/plate.1.exr", plate.read_bytes())
    here, there = read_image(plate), read_image(uri)
    np.testing.assert_array_equal(here.pixels, there.pixels)
    assert here.windows == there.windows
    assert str(there.path) == uri
    uri = bucket.put("in/plate.1.exr", plate.read_bytes()[:1000])
    with pytest.raises(InputError):
        read_image(uri)


def test_a_full_temporary_folder_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = write_plate(tmp_path, 1, DISPLAY).read_bytes()

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(pathlib.Path, "write_bytes", full)
    with pytest.raises(OutputError):
        read_image(None, data)


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


def test_its_outputs_have_names_of_their_own(tmp_path: Path) -> None:
    plate, jpg = tmp_path / "plate.exr", tmp_path / "plate.jpg"
    assert output_bases([plate]) == ["plate"]
    for path in (jpg, tmp_path / "depth.exr"):
        write_picture(path.with_suffix(".png")).rename(path)
    assert output_bases([plate]) == ["plate.exr"]
    assert output_bases([jpg]) == ["plate"]
    assert output_bases([jpg, plate]) == output_bases([plate, jpg])[::-1] == ["plate", "plate.exr"]
    for out in (None, f"{tmp_path}/out/"):
        plans = plan_outputs([jpg, plate], picture_destination(out, (Format.NPY,)))
        names = [plan.outputs["npy"].name for plan in plans]
        assert names == ["plate.depth.npy", "plate.exr.depth.npy"]
    destination = picture_destination(f"{tmp_path}/out/", (Format.NPY,))
    plans = plan_outputs([jpg, tmp_path / "b" / "plate.exr"], destination)
    assert [plan.outputs["npy"].name for plan in plans] == [
        "plate.jpg.depth.npy",
        "plate.exr.depth.npy",
    ]
    assert output_bases([tmp_path / "a.exr", tmp_path / "A.EXR"])[0].startswith("a.exr.")


def test_a_batch_reads_those_of_a_list_alone(tmp_path: Path, loader: SessionLoader) -> None:
    root, out = tmp_path / "in", tmp_path / "batch"
    plate = write_plate(root, 1, MIXED)
    done = predicted(plate, loader, Format.EXR, anchors=(Anchor(20, 20, 3.5),))
    own = (root / "out" / "plate.1.depth.exr").rename(root / "own.exr")
    write_picture(root / "room.png")
    whole = plan_folder(str(root), str(out))
    assert [file.name for file in whole.inputs] == ["room.png"]
    assert {(file.name, file.reason) for file in whole.skipped} == {
        ("plate.1.exr", ".exr"),
        ("own.exr", ".exr"),
    }
    plan = plan_files([plate.name, own.name], "mine", str(root), str(out))
    options = BatchOptions((Format.EXR, Format.NPY), anchors=(Anchor(20, 20, 3.5),))
    rows = {result.row.input: result.row for result in Batch(BatchRequest(plan, options, loader))}
    assert rows[plate.name].status == OK
    assert rows[plate.name].camera == camera_text(done.depth)
    np.testing.assert_array_equal(np.load(out / "plate.1.depth.npy"), done.depth.values)
    assert written(out / "plate.1.depth.exr")[:2] == (MIXED, DISPLAY)
    assert rows["own.exr"].error
