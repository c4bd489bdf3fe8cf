"""Options of the camera: a table, a calibration."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.folders import printed, rows, tree
from helpers.tiny import synthetic_image, write_image, write_model
from helpers.videos import flat_frames, write_video


@pytest.fixture
def scene(inside: Cli) -> Cli:
    """A folder of two images, a table for one of them, and a model that learned a camera."""
    write_model(inside.models / "default", camera={"hfov_deg": 60.0})
    tree(inside, "a.png", "hall/b.png")
    (inside.folder / "cameras.csv").write_text("id,focal_px\nhall/b,40\nattic,50\n")
    return inside


def test_the_summary_of_what_does_not_match(scene: Cli) -> None:
    words = ("batch", "in", "--out", "out", "--cameras", "cameras.csv")
    for extra in ((), ("--dry-run",)):
        done = scene(*words, *extra, code=0)
        without, *_ = done.stderr.decode().splitlines()
        assert without.startswith("depthcli: warning: cameras.csv has no camera for 1 of 2 ")
    assert rows(scene, "out")["hall/b.png"]["camera"].endswith("(given)")
    assert rows(scene, "out")["a.png"]["camera"].endswith("(assumed, from the model's card)")
    (scene.folder / "cameras.csv").write_text("id,focal_px\nhall/b,41\n")
    again = printed(scene(*words, "--json"))
    assert {row["input"]: row["kept"] for row in again} == {"a.png": True, "hall/b.png": False}


def test_the_table_precedes_the_camera_of_a_profile(scene: Cli) -> None:
    (scene.folder / "depthcli.toml").write_text("[lens]\nhfov = 80\n")
    words = ("batch", "in", "--out", "out", "--profile", "lens", "--cameras", "cameras.csv")
    assert scene(*words).returncode == 0
    cameras = [row["camera"] for row in rows(scene, "out").values()]
    assert cameras == ["hfov 60.0° (assumed, from the model's card)", "hfov 44.8° (given)"]


CALIBRATION = """image_width: 64
image_height: 48
camera_matrix:
  rows: 3
  cols: 3
  data: [80.0, 0, 30.5, 0, 80.0, 25.25, 0, 0, 1]
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0, 0, 0, 0, 0]
"""
DISTORTED = CALIBRATION.replace("[0, 0,", "[-0.1, 0,")
GIVEN = ("--focal-px", "80", "--centre-px", "30.5,25.25")


@pytest.fixture
def folder(inside: Cli) -> Path:
    """An image, a calibration, and a model that learned another camera."""
    write_model(inside.models / "default", camera={"hfov_deg": 60.0})
    write_image(inside.folder / "room.png", synthetic_image())
    (inside.folder / "cam.yaml").write_text(CALIBRATION)
    return inside.folder


def test_predict_has_what_the_options_give(inside: Cli, folder: Path) -> None:
    formats = ("--format", "npy", "--format", "ply", "--format", "png16", "--json")
    facts = []
    for name, words in (("a", GIVEN), ("b", ("--calibration", "cam.yaml"))):
        done = inside("predict", "room.png", "-o", f"{name}/", *formats, *words)
        assert (done.returncode, done.stderr) == (0, b"")
        facts.append(json.loads(done.stdout))
    assert facts[1]["focal_px"] == pytest.approx(80)
    for field in ("centre_px", "camera", "camera_source"):
        assert facts[0][field] == facts[1][field]
    assert facts[1]["centre_px"] == [30.5, 25.25]
    for name in ("room.depth.png", "room.ply", "room.depth.npy"):
        assert (folder / "a" / name).read_bytes() == (folder / "b" / name).read_bytes()


@pytest.mark.parametrize("command", ["predict", "batch", "video"])
def test_a_distorted_lens_is_one_warning_or_undistorted(
    inside: Cli, folder: Path, command: str
) -> None:
    (folder / "cam.yaml").write_text(DISTORTED)
    image = synthetic_image()
    for number in range(2):
        write_image(folder / "in" / f"f{number}.png", image)
    words = {
        "predict": ("in/f0.png", "in/f1.png", "-o", "out/"),
        "batch": ("in", "--out", "out"),
        "video": ("in/f%d.png", "--out", "out/", "--fps", "25"),
    }[command]
    words = (*words, "--format", "npy", "--calibration")
    done = inside(command, *words, "cam.yaml", code=0)
    assert done.stderr.decode().count("the camera has lens distortion, which is not removed") == 1
    assert not inside(command, *words, "cam.yaml", "--quiet", code=0).stderr
    done = inside(command, *words, "cam.yaml", "--undistort", "--overwrite", code=0)
    assert not done.stderr
    matrix = np.array([[80, 0, 30.5], [0, 80, 25.25], [0, 0, 1]])
    write_image(folder / "flat.png", cv2.undistort(image, matrix, np.array([-0.1, 0, 0, 0])))
    inside("predict", "flat.png", *GIVEN, "-o", "flat.npy", code=0)
    (path, _) = sorted((folder / "out").glob("*.npy"))
    np.testing.assert_allclose(np.load(path), np.load(folder / "flat.npy"), rtol=1e-6)


def test_a_scale_is_measured_and_used_on_undistorted_images(inside: Cli, folder: Path) -> None:
    (folder / "cam.yaml").write_text(DISTORTED)
    lens = ("--calibration", "cam.yaml", "--undistort")
    inside("calibrate", "wide", "room.png", *lens, "--anchor", "9,4,5", code=0)
    inside("predict", "room.png", *lens, "-o", "own.npy", code=0)
    inside("predict", "room.png", "--camera", "wide", "-o", "kept.npy", code=0)
    own_m, kept_m = (np.load(folder / f"{name}.npy") for name in ("own", "kept"))
    np.testing.assert_allclose(kept_m, own_m * (5 / own_m[4, 9]), rtol=1e-5)
    assert kept_m[4, 9] == pytest.approx(5)
    inside("predict", "room.png", "--camera", "wide", "--hfov", "60", "-o", "no.npy", code=2)
    inside("calibrate", "wide", "--pairs", ".", *lens, code=2)  # depth of distorted images
    done = inside("calibrate", "a", "room.png", "--anchor", "9,4,5", XDG_CONFIG_HOME="/dev/null")
    assert (done.returncode, b"--out" in done.stderr) == (1, False)


def test_points_that_a_reconstruction_saw_in_images_are_not_those_of_undistorted_ones(
    inside: Cli, folder: Path
) -> None:
    """COLMAP states keypoints in the pixels of the images that it was given."""
    (folder / "sparse").mkdir()
    (folder / "sparse/cameras.txt").write_text("1 SIMPLE_RADIAL 64 48 80 31 25.75 -0.1\n")
    (folder / "sparse/images.txt").write_text("1 1 0 0 0 0 0 0 1 room.png\n20 20 1 40 30 2\n")
    (folder / "sparse/points3D.txt").write_text("1 0 0 2 0 0 0 0\n2 0 0 3 0 0 0 0\n")
    words = ("predict", "room.png", "-o", "d.npy", "--calibration", "sparse/cameras.txt")
    inside(*words, "--anchors", "sparse", code=0)
    inside(*words, "--anchors", "sparse", "--undistort", code=2)


def test_a_video_has_what_the_options_give(inside: Cli, folder: Path) -> None:
    write_video(folder / "clip.avi", flat_frames(range(2)))
    depths, sidecars = [], []
    words = ("video", "clip.avi", "--format", "npy", "--sidecar", "--out")
    for name, camera in (("a", GIVEN), ("b", ("--calibration", "cam.yaml"))):
        assert inside(*words, f"{name}/", *camera).returncode == 0
        depths.append([np.load(path) for path in sorted((folder / name).glob("*.npy"))])
        (sidecar,) = (folder / name).glob("*.json")
        sidecars.append(json.loads(sidecar.read_text()))
    np.testing.assert_allclose(*depths, rtol=1e-6)
    assert sidecars[0]["centre_px"] == sidecars[1]["centre_px"] == [30.5, 25.25]
    (folder / "cam.yaml").write_text(CALIBRATION.replace("48", "20"))
    inside("video", "clip.avi", "--out", "c.mkv", "--calibration", "cam.yaml", code=1)
    assert not (folder / "c.mkv").exists()


def test_the_calibration_is_not_replaced(inside: Cli, folder: Path) -> None:
    (folder / "cam.yaml").rename(folder / "cam.json")
    words = ("predict", "room.png", "-o", "./cam.json", "--format", "json")
    assert inside(*words, "--calibration", "cam.json").returncode == 1
    assert (folder / "cam.json").read_text() == CALIBRATION
