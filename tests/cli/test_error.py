"""The error that depth is expected to have, from a second model to every output that has it."""

import json
import re

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.tiny import synthetic_image, write_image, write_model
from helpers.videos import write_video

import depthcli

IMAGE = synthetic_image(24, 32)
EXPECTED = 0.05 + 0.1 * IMAGE.max(2) / 255  # what is white is twice as wrong


@pytest.fixture
def unsure(inside: Cli) -> Cli:
    """A command line whose default model knows its error, in a folder with an image."""
    output = {"kind": "relative", "transform": "linear", "scale": 0.05, "shift": 0.1}
    write_model(inside.models / "unsure", name="unsure", output=output)
    write_model(inside.models / "default", error_model="unsure", camera={"hfov_deg": 60.0})
    write_image(inside.folder / "a.png", IMAGE)
    return inside


def test_files_with_the_error_are_read_back(unsure: Cli) -> None:
    unsure(
        "predict", "a.png", *(w for f in ("error", "exr", "npz") for w in ("--format", f)), code=0
    )
    steps = cv2.imread(str(unsure.folder / "a.error.png"), cv2.IMREAD_UNCHANGED)
    assert steps.dtype == np.uint16
    np.testing.assert_allclose(steps / 10_000, EXPECTED, atol=0.03)  # the network's size is smaller
    for name in ("a.depth.exr", "a.depth.npz"):
        depth = depthcli.read_depth(unsure.folder / name)
        np.testing.assert_allclose(depth.error, steps / 10_000, atol=6e-5)
        assert depth.error.dtype == np.float32
    unsure("predict", "a.png", "-o", "plain.exr", code=0)
    assert depthcli.read_depth(unsure.folder / "plain.exr").error is None
    done = unsure("info", "a.error.png", code=1)
    assert b"expected error" in done.stderr
    assert unsure("predict", "a.error.png", code=None).returncode  # no depth of an error


def test_the_error_does_not_change_depth(unsure: Cli) -> None:
    unsure("predict", "a.png", "-o", "plain.npy", code=0)
    done = unsure("predict", "a.png", "-o", "a.npy", "--error", "--json", code=0)
    plain, depth = (np.load(unsure.folder / name) for name in ("plain.npy", "a.npy"))
    np.testing.assert_array_equal(depth, plain)
    assert json.loads(done.stdout)["expected_error"] == pytest.approx(np.median(EXPECTED), abs=0.02)


def test_depth_that_follows_points_is_surer_near_them(unsure: Cli) -> None:
    rows = [
        f"{x},{y},{2 + x / 20}" for x, y in ((2, 2), (2, 20), (8, 12), (12, 4), (14, 20), (6, 6))
    ]
    (unsure.folder / "known.csv").write_text("\n".join(["x,y,depth_m", *rows]))
    errors = {}
    for fit in ("global", "local"):
        words = ("--anchors", "known.csv", "--anchors-fit", fit, "--error")
        unsure("predict", "a.png", "-o", f"{fit}.exr", *words, code=0)
        errors[fit] = depthcli.read_depth(unsure.folder / f"{fit}.exr").error
    np.testing.assert_allclose(
        errors["global"], 1.15 * EXPECTED**1.287 * (7 / 6) ** 0.933, rtol=0.3
    )
    ratio = errors["local"] / errors["global"]
    assert ratio[12, 8] < ratio[12, 24] / 4


def test_predict_info_probe_and_the_page_show_the_error(unsure: Cli) -> None:
    line = unsure("predict", "a.png", "-o", "a.exr", "--error", code=0).stdout.decode()
    error = depthcli.read_depth(unsure.folder / "a.exr").error
    assert f"m, expected error {np.median(error):.0%}" in line
    info = json.loads(unsure("info", "a.exr", "--json", code=0).stdout)
    assert info["expected_error"] == pytest.approx(np.median(error))
    text = unsure("probe", "a.exr", "3,4", "0,0,32,24", code=0).stdout.decode()
    assert f"± {error[4, 3]:.0%}" in text
    assert f"expected error {np.median(error):.0%}" in text
    facts = json.loads(unsure("probe", "a.exr", "3,4", "--json", code=0).stdout)
    assert facts["error"] == pytest.approx(error[4, 3])
    unsure("predict", "a.png", "-o", "a.html", "--error", code=0)
    assert re.search('"error": "[^"]{8,}"', (unsure.folder / "a.html").read_text())
    unsure("convert", "a.exr", "-o", "b.exr", code=0)
    np.testing.assert_array_equal(depthcli.read_depth(unsure.folder / "b.exr").error, error)


@pytest.mark.parametrize("name", ["a.ply", "a.glb"])
def test_points_with_a_large_error_are_left_out(unsure: Cli, name: str) -> None:
    sizes = []
    for most in ("1", "0.1", "0.01"):
        done = unsure(
            "predict", "a.png", "-o", name, "--keep-edges", "--max-error", most, code=None
        )
        sizes.append((unsure.folder / name).stat().st_size if not done.returncode else 0)
        (unsure.folder / name).unlink(missing_ok=True)
    assert sizes[0] > sizes[1] > sizes[2] == 0
    assert b"--max-error" in done.stderr


def test_what_has_no_error_says_so(unsure: Cli) -> None:
    write_model(unsure.models / "other", name="other")
    done = unsure("predict", "a.png", "--format", "error", "--model", "other", code=1)
    assert b"'other' is not known" in done.stderr
    unsure("predict", "a.png", "-o", "a.npy", code=0)
    assert b"--max-error" in unsure("convert", "a.npy", "-o", "a.ply", "--max-error", "1").stderr


def test_a_batch_writes_the_error_of_each(unsure: Cli) -> None:
    for i in range(3):
        write_image(unsure.folder / f"in/{i}.png", IMAGE // (i + 1))
    unsure("batch", "in", "-o", "out", "--format", "error", code=0)
    medians = [
        np.median(cv2.imread(str(unsure.folder / f"out/{i}.error.png"), cv2.IMREAD_UNCHANGED))
        for i in range(3)
    ]
    assert medians[0] > medians[1] > medians[2] > 0


def test_frames_of_a_video_have_the_error(unsure: Cli) -> None:
    write_video(unsure.folder / "clip.mkv", [IMAGE] * 2)
    words = ("-o", "out/%04d.exr", "--error", "--smooth", "0.2")
    unsure("video", "clip.mkv", *words, code=0)
    for path in (unsure.folder / "out").glob("*.exr"):
        np.testing.assert_allclose(depthcli.read_depth(path).error, EXPECTED, atol=0.03)
