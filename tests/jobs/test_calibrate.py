"""Scales of cameras, measured on known depth and used by other commands."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from helpers.tiny import fixed_inside, load, synthetic_image, write_image, write_model

import depthcli
from depthcli.core.camera import CameraScale, Intrinsics, hfov_deg
from depthcli.errors import DepthcliError, InputError, UsageError
from depthcli.io.calibration import keep_camera, kept_camera
from depthcli.io.images.read import read_image
from depthcli.jobs.calibrate import CalibrationRequest, KnownObject, calibrate
from depthcli.known.clouds import projected
from depthcli.known.files import KnownDepthFiles

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from helpers.command_line import Cli

    from depthcli.inference.pipeline import Pipeline

    Truth = Callable[[np.ndarray, np.random.Generator], np.ndarray]


@pytest.fixture
def pipeline(model_folder: Path) -> Pipeline:
    return load(model_folder)


def request(pipeline: Pipeline, folder: Path, truth: Truth, images: int = 4) -> CalibrationRequest:
    """Images whose known depth is a function of the predicted one."""
    random, names = np.random.default_rng(0), []
    (folder / "known").mkdir()
    for i in range(images):
        pixels = np.roll(synthetic_image(), 7 * i, axis=1)
        name = write_image(folder / "images" / f"{i}.png", pixels)
        predicted_m = pipeline.predict(read_image(name)).depth.values
        np.save(folder / "known" / f"{i}.npy", truth(predicted_m, random).astype(np.float32))
        names.append(str(name))
    return CalibrationRequest(
        "robot", pipeline, tuple(names), anchors=KnownDepthFiles(str(folder / "known"))
    )


def test_finds_the_scale(pipeline: Pipeline, tmp_path: Path) -> None:
    done = calibrate(request(pipeline, tmp_path, lambda depth_m, _: 1.3 * depth_m))
    assert done.scale.scale == pytest.approx(1.3, rel=1e-5)
    assert (done.scale.shift_m, done.scale.images) == (0, 4)
    assert done.scale.residual == pytest.approx(0, abs=1e-5)
    assert done.before == pytest.approx(1 - 1 / 1.3, rel=1e-5)


def test_uses_a_shift_if_it_helps_on_images_left_out(pipeline: Pipeline, tmp_path: Path) -> None:
    shifted = calibrate(request(pipeline, tmp_path, lambda depth_m, _: 0.8 * depth_m + 0.7))
    assert (shifted.scale.scale, shifted.scale.shift_m) == pytest.approx((0.8, 0.7), rel=1e-3)
    (tmp_path / "noisy").mkdir()
    noisy = calibrate(
        request(
            pipeline,
            tmp_path / "noisy",
            lambda depth_m, random: 1.2 * depth_m * random.lognormal(0, 0.2, depth_m.shape),
        )
    )
    assert (noisy.scale.scale, noisy.scale.shift_m) == (pytest.approx(1.2, rel=0.02), 0)


def test_an_object_of_known_height_gives_its_depth(pipeline: Pipeline, tmp_path: Path) -> None:
    name = write_image(tmp_path / "a.png")
    box = KnownObject(10, 8, 30, 28, 1.5)
    camera = Intrinsics(focal_px=50, pixel_aspect=1.2)  # wide pixels: fy is 60
    done = calibrate(
        CalibrationRequest("a", pipeline, (str(name),), known_object=box, camera=camera)
    )
    depth = pipeline.predict(read_image(name), camera).depth.values
    assert depth[18, 20] * done.scale.scale == pytest.approx(60 * 1.5 / 20)
    assert done.scale.residual is None


def test_other_commands_use_the_kept_camera(inside: Cli) -> None:
    pairs = inside.folder / "pairs"
    for i in range(2):
        write_image(pairs / "rgb" / f"{i}.png", np.roll(synthetic_image(), 5 * i, axis=1))
        inside("predict", f"pairs/rgb/{i}.png", "-o", f"{i}.npy", "--hfov", "70", code=0)
        depth_mm = np.load(inside.folder / f"{i}.npy") * 1500
        write_image(pairs / "depth" / f"{i}.png", depth_mm.astype(np.uint16))
    done = inside("calibrate", "robot", "--pairs", "pairs", "--hfov", "70", "--json")
    facts = json.loads(done.stdout)
    assert (facts["scale"], facts["hfov_deg"]) == (
        pytest.approx(1.5, rel=2e-3),
        pytest.approx(70),
    )
    done = inside("predict", "pairs/rgb/0.png", "-o", "a.npy", "--camera", "robot", "--json")
    assert json.loads(done.stdout)["camera_scale"]["name"] == "robot"
    inside("batch", "pairs/rgb", "-o", "out", "--camera", "robot", "--format", "npy")
    expected = np.load(inside.folder / "0.npy") * np.float32(facts["scale"])
    for written in ("a.npy", "out/0.depth.npy"):
        assert np.load(inside.folder / written) == pytest.approx(expected, rel=1e-5)


def test_the_kept_camera_gives_the_points_of_its_calibration(inside: Cli) -> None:
    """Of an image that was resized, whose pixels are not square."""
    for name, size in (("a", (48, 64)), ("b", (96, 128))):
        write_image(inside.folder / f"{name}.png", synthetic_image(*size))
    matrix = {"fx": 50, "fy": 60, "cx": 20, "cy": 30, "width": 64, "height": 48}
    (inside.folder / "lens.json").write_text(json.dumps(matrix))
    lens = ("--calibration", "lens.json")
    done = inside("calibrate", "r", "a.png", *lens, "--anchor", "3,4,9", "--json")
    scale = np.float32(json.loads(done.stdout)["scale"])
    points_m = []
    for words in (("--camera", "r"), lens):
        assert inside("predict", "b.png", *words, "-o", f"{words[0]}.exr").returncode == 0
        depth = depthcli.read_depth(inside.folder / f"{words[0]}.exr")
        points_m.append(depth.to_points(keep_edges=True).xyz_m)
    assert points_m[0] == pytest.approx(points_m[1] * scale, rel=1e-5)
    messages = [
        inside("predict", "b.png", "--camera", "r", *more, code=0).stderr
        for more in ((), ("--centre-px", "9,9"))
    ]
    assert messages[0] == messages[1]  # and nothing of a size that was not stated


def test_a_kept_camera_has_the_pixels_of_clouds_and_of_other_sizes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    scale = CameraScale("r", "tiny", "0" * 64, 1.5, 0.0, None, 1, 1)
    lens = Intrinsics(None, hfov_deg(50, 64), (20, 30), (64, 48), 1.2)
    path, cloud_m = keep_camera(scale, lens), np.array([[1.0, 1.0, 5.0]])
    points = projected(cloud_m, kept_camera("r")).within(128, 96)
    assert (points.x[0], points.y[0]) == (2 * (20 + 10) + 1, 2 * (30 + 12) + 1)
    cam = kept_camera("r").of_image(Intrinsics(100))
    assert (cam.centre_for(128, 96), cam.pixel_aspect, cam.scale) == ((40.5, 60.5), 1.2, scale)
    first = json.loads(path.read_text())  # as 0.22 wrote it
    path.write_text(json.dumps({"hfov_deg": first["hfov_deg"], **asdict(scale)}))
    assert kept_camera("r") == Intrinsics(hfov_deg=first["hfov_deg"], scale=scale)
    wrong = {
        "hfov_deg": True,
        "pixel_aspect": [1],
        "distortion": "x",
        "size_px": [64],
        "scale": "2",
    }
    for name, value in wrong.items():  # were 1°, or an unexpected error
        path.write_text(json.dumps({**first, name: value}))
        with pytest.raises(UsageError, match=f"{name} has to be"):
            kept_camera("r")


def test_a_scale_is_refused_by_another_model(inside: Cli, model_folder: Path) -> None:
    write_image(inside.folder / "a.png")
    inside("calibrate", "robot", "a.png", "--anchor", "3,4,2.5")
    assert inside("predict", "a.png", "--camera", "robot").returncode == 0
    assert inside("predict", "a.png", "--camera", "unknown").returncode == 2
    other = write_model(model_folder.parent / "other", fixed_inside())
    assert inside("predict", "a.png", "--camera", "robot", "--model", other).returncode == 2


def test_doubts_about_known_depth_are_told(pipeline: Pipeline, tmp_path: Path) -> None:
    """A map of KITTI, 256 units a metre, gave a scale that is four times too small."""
    name = write_image(tmp_path / "a.png")
    cv2.imwrite(str(tmp_path / "lidar.png"), np.full((48, 64), 256 * 5, np.uint16))
    for scale, count in ((None, 1), (256, 0)):
        files = KnownDepthFiles(str(tmp_path / "lidar.png"), scale)
        done = calibrate(CalibrationRequest("a", pipeline, (str(name),), anchors=files))
        assert len(done.warnings) == count, done.warnings


def test_needs_known_depth(pipeline: Pipeline, tmp_path: Path) -> None:
    name = write_image(tmp_path / "a.png")
    np.save(tmp_path / "a.npy", np.full((48, 64), np.nan, np.float32))
    files = KnownDepthFiles(str(tmp_path / "a.npy"))
    with pytest.raises(InputError):
        calibrate(CalibrationRequest("a", pipeline, (str(name),), anchors=files))


def test_pairs_are_images_and_depth_of_the_same_names(pipeline: Pipeline, tmp_path: Path) -> None:
    for name, factor in (("a", 1.25), ("hall/b", 1.25)):
        image = write_image(tmp_path / "rgb" / f"{name}.png", synthetic_image())
        depth_m = factor * pipeline.predict(read_image(image)).depth.values
        (tmp_path / "depth" / name).parent.mkdir(parents=True, exist_ok=True)
        np.save(tmp_path / "depth" / f"{name}.npy", depth_m)
    done = calibrate(CalibrationRequest("robot", pipeline, pairs=tmp_path))
    assert (done.scale.images, done.scale.scale) == (2, pytest.approx(1.25, rel=1e-5))
    (tmp_path / "depth" / "a.npy").unlink()
    with pytest.raises(InputError, match="has no known depth for it: a with"):
        calibrate(CalibrationRequest("robot", pipeline, pairs=tmp_path))
    (tmp_path / "empty" / "rgb").mkdir(parents=True)
    for folder, message in ("empty", "no known depth"), ("depth", "rgb cannot be listed"):
        with pytest.raises(DepthcliError, match=message):
            calibrate(CalibrationRequest("robot", pipeline, pairs=tmp_path / folder))
