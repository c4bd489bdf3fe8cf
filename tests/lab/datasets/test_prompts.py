"""Known depth as sensors give it."""

from dataclasses import replace

import numpy as np
import pytest

from depthcli.errors import UsageError
from depthcli.lab.datasets.prompts import Pattern, Prompt, parsed_prompt

HEIGHT, WIDTH = 60, 80
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
PLANE_M = 2 + COLUMNS / 40 + ROWS / 60
BOXES = ((ROWS // 12 + COLUMNS // 16) % 2).astype(np.float32)


def _drawn(
    text: str, depth_m: np.ndarray = PLANE_M, seed: int = 0, **changes: object
) -> np.ndarray:
    prompt = replace(parsed_prompt(text), **changes)  # type: ignore[arg-type]
    return prompt.draw(depth_m, BOXES, np.random.default_rng(seed))


@pytest.mark.parametrize("pattern", Pattern)
def test_exact_points_have_the_depth_of_the_map_and_the_seed_decides_them(pattern: Pattern) -> None:
    sparse = _drawn(f"{pattern}:9")
    valid = sparse > 0
    assert 0 < valid.mean() < 1
    np.testing.assert_array_equal(sparse[valid], PLANE_M[valid])
    np.testing.assert_array_equal(sparse, _drawn(f"{pattern}:9"))
    holes = np.where(ROWS < HEIGHT / 2, np.float32(np.nan), PLANE_M)
    assert not _drawn(f"{pattern}:9", holes)[: HEIGHT // 2].any()


def test_number_of_points() -> None:
    assert np.count_nonzero(_drawn("uniform:500")) == 500
    assert np.count_nonzero(_drawn("uniform:99999")) == PLANE_M.size
    assert np.count_nonzero(_drawn("corners:7")) == 7


def test_lidar_lines_are_slanted_lines() -> None:
    y, x = np.nonzero(_drawn("lidar:1", seed=3))
    slope, first = np.polyfit(x, y, 1)
    assert np.abs(y - (first + slope * x)).max() < 1
    assert 0.01 < abs(slope) < 0.1
    lines = np.count_nonzero(_drawn("lidar:4")) / np.count_nonzero(_drawn("lidar:1"))
    assert 2 < lines < 8


def test_depth_camera_has_holes_at_edges_and_far_away() -> None:
    step_m = np.where(COLUMNS < 41, np.float32(2), np.float32(3))
    y, x = np.nonzero(_drawn("camera:16", step_m))
    assert len(np.unique(x)) == 16
    assert len(np.unique(y)) == 12
    beside = (np.abs(x - 41) < 5).sum()
    assert 0 < beside < 0.6 * 2 * 12
    assert len(x) - beside == 14 * 12
    assert not _drawn("camera:16", step_m + 3).any()
    assert _drawn("camera:16", step_m + 3, range_m=6.0).max() == 5


def test_corners_are_those_of_the_image() -> None:
    y, x = np.nonzero(_drawn("corners:20"))
    assert (np.abs((y + 6) % 12 - 6) <= 2).all()
    assert (np.abs((x + 8) % 16 - 8) <= 2).all()


def test_errors_are_as_large_as_stated() -> None:
    flat_m = np.full((200, 200), 2, np.float32)
    gray = np.zeros_like(flat_m)

    def errors(prompt: Prompt) -> np.ndarray:
        sparse = prompt.draw(flat_m, gray, np.random.default_rng(0))
        return sparse[sparse > 0] / 2 - 1

    exact = parsed_prompt("uniform:20000")
    assert errors(parsed_prompt("uniform:20000,noise=0.02")).std() == pytest.approx(0.02, rel=0.05)
    wrong = np.abs(errors(parsed_prompt("uniform:20000,wrong=0.25")))
    assert (wrong > 0).mean() == pytest.approx(0.25, abs=0.01)
    assert wrong[wrong > 0].min() > 1 / 6 - 1e-6
    kinect = errors(replace(exact, has_kinect_noise=True)).std()
    assert kinect == pytest.approx((0.0012 + 0.0019 * 1.6**2) / 2, rel=0.05)


def test_wrong_calibration_and_missing_parts() -> None:
    moved = _drawn("uniform:300", shift_px=(2.0, -1.0))
    y, x = np.nonzero(moved)
    inner = (x < WIDTH - 2) & (y > 0)
    np.testing.assert_array_equal(moved[y, x][inner], PLANE_M[y - 1, (x + 2) % WIDTH][inner])
    y, x = np.nonzero(_drawn("uniform:3000", part=(0.25, 0.5, 0.5, 1.0)))
    assert (x.min(), x.max(), y.min(), y.max()) == (20, 39, 30, 59)


@pytest.mark.parametrize(
    "text", ["uniform", "uniform:0", "radar:4", "lidar:4,noise=2", "lidar:4,x=0.1"]
)
def test_other_forms_are_refused(text: str) -> None:
    with pytest.raises(UsageError):
        parsed_prompt(text)
    assert parsed_prompt("lidar:4,noise=0.02,wrong=0.25") == Prompt(
        Pattern.LIDAR, 4, 0.02, wrong=0.25
    )
