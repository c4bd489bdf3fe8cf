"""Cuts, motion, smoothing, flicker and range lock, against plain loops and known cases."""

import math
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from depthcli.core.temporal import (
    THUMBNAIL_PX,
    Change,
    ChangeDetector,
    Correction,
    Deflicker,
    FlickerMeter,
    RangeLock,
    Smoother,
    ema_decay,
    from_log,
    thumbnail,
    to_log,
)
from depthcli.core.types import DepthKind, DepthMap

Array = np.ndarray[Any, np.dtype[np.float32]]


def noise(seed: int, shape: tuple[int, ...] = (12, 16)) -> Array:
    return np.random.default_rng(seed).random(shape, np.float32)


def at(values: Array, row: int, column: int) -> float:
    """A pixel, or the nearest one of the edge."""
    height, width = values.shape
    return float(values[min(max(row, 0), height - 1), min(max(column, 0), width - 1)])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 9), st.integers(1, 9))
def test_a_difference_is_that_of_means_over_25_pixels(seed: int, height: int, width: int) -> None:
    values = noise(seed, (height, width))
    expected = [
        [
            np.mean([at(values, y + j, x + i) for j in range(-2, 3) for i in range(-2, 3)])
            for x in range(width)
        ]
        for y in range(height)
    ]
    changes = ChangeDetector()
    changes.step(np.zeros_like(values))
    np.testing.assert_allclose(changes.step(values).difference, expected, atol=1e-6)


def test_stillness_takes_the_largest_change_nearby() -> None:
    difference = noise(3) * np.float32(0.06)
    still = Change(difference, is_cut=False).static_weight
    for y in range(12):
        for x in range(16):
            near = max(at(difference, y + j, x + i) for j in (-1, 0, 1) for i in (-1, 0, 1))
            assert still[y, x] == pytest.approx(1 - min(near / 0.06, 1), abs=1e-5)


def test_a_change_of_two_percent_is_not_still() -> None:
    difference = np.float32([[0, np.nextafter(np.float32(0.02), np.float32(0)), 0.02, 1]])
    meter = FlickerMeter(DepthKind.METRIC)
    meter.step(np.zeros((1, 4), np.float32), Change(difference, is_cut=True))
    meter.step(np.float32([[1, 2, 4, 8]]), Change(difference, is_cut=False))
    assert meter.value == 1.5


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_a_guide_is_brightness_at_a_bounded_size(dtype: type) -> None:
    top = 1 if dtype is np.float32 else np.iinfo(dtype).max
    pixels = np.full((300, 600, 3), top, dtype)
    small = thumbnail(pixels)
    assert small.shape == (THUMBNAIL_PX // 2, THUMBNAIL_PX)
    np.testing.assert_allclose(small, 1, atol=1e-5)
    assert thumbnail(pixels[:7, :9, 0]).shape == (7, 9)
    assert thumbnail(pixels[:1]).shape == thumbnail(pixels[:, :1]).T.shape == (1, THUMBNAIL_PX)


def test_a_new_scene_is_a_cut_and_motion_is_not() -> None:
    changes = ChangeDetector()
    scene = noise(0)
    assert changes.step(scene).is_cut  # the first image
    assert not changes.step(scene).is_cut
    for shift in range(1, 6):
        wave = 0.5 + 0.05 * np.sin(np.arange(16) / 3 + shift)
        moving = np.tile(wave, (12, 1)).astype(np.float32)
        assert changes.step(moving).is_cut == (shift == 1 and abs(scene.mean() - 0.5) > 0.08)
    assert changes.step(np.zeros((12, 16), np.float32)).is_cut
    assert not changes.step(np.zeros((12, 16), np.float32)).is_cut


def cuts(steps: list[float]) -> list[bool]:
    """Whether each step of a flat image's brightness is a cut."""
    changes = ChangeDetector()
    level = 0.5
    changes.step(np.full((8, 8), level, np.float32))
    found = []
    for size in steps:
        level += size if level < 0.5 else -size  # to and fro, within [0, 1]
        found.append(changes.step(np.full((8, 8), level, np.float32)).is_cut)
    return found


@given(st.lists(st.floats(0, 0.45), max_size=30))
def test_cuts_are_those_of_a_plain_loop(steps: list[float]) -> None:
    usual, expected = 0.0, []
    for size in steps:
        bound = max(0.08, 3 * usual)
        assume(abs(size - bound) > 1e-4)
        expected.append(size > bound)
        usual = 0.0 if size > bound else 0.8 * usual + 0.2 * size
    assert cuts(steps) == expected


STATIC = Change(np.zeros((12, 16), np.float32), is_cut=False)
STEADY = Correction(np.zeros((3, 4), np.float32), np.ones((3, 4), np.float32))


def test_smoothing_a_still_image_is_an_exponential_mean() -> None:
    smoother, decay = Smoother(), ema_decay(1 / 30, 0.2)
    expected = noise(0).astype(np.float64)
    smoother.step(noise(0), STATIC, STEADY, decay)
    for seed in range(1, 8):
        now = noise(seed)
        for y in range(12):
            for x in range(16):
                expected[y, x] = decay * expected[y, x] + (1 - decay) * now[y, x]
        np.testing.assert_allclose(smoother.step(now, STATIC, STEADY, decay), expected, atol=1e-5)


def test_smoothing_stops_where_the_image_moves_and_at_cuts() -> None:
    difference = np.zeros((12, 16), np.float32)
    difference[:, 8:] = 0.5
    smoother = Smoother()
    smoother.step(np.zeros((12, 16), np.float32), STATIC, STEADY, 0.9)
    ones = np.ones((12, 16), np.float32)
    half = smoother.step(ones, Change(difference, is_cut=False), STEADY, 0.9)
    np.testing.assert_allclose(half[:, :7], 0.1, atol=1e-6)
    np.testing.assert_array_equal(half[:, 8:], 1)
    np.testing.assert_array_equal(
        smoother.step(ones * 5, Change(difference, is_cut=True), STEADY, 0.9), 5
    )


def test_smoothing_stops_where_motion_explains_the_change() -> None:
    stillness = np.array([[1, 1, 0, 0]] * 3, np.float32)
    smoother, steady = Smoother(), Correction(STEADY.rise, stillness)
    smoother.step(np.zeros((12, 16), np.float32), STATIC, STEADY, 0.9)
    half = smoother.step(np.ones((12, 16), np.float32), STATIC, steady, 0.9)
    np.testing.assert_allclose(half[:, :6], 0.1, atol=1e-6)
    np.testing.assert_array_equal(half[:, 10:], 1)


def corrections(
    images: list[Array], logs: list[Array], look_ahead: int, cuts: set[int], decay: float = 0.8
) -> list[Correction]:
    deflicker, found = Deflicker(look_ahead), []
    for i, (image, values) in enumerate(zip(images, logs, strict=True)):
        found += deflicker.step(image, values, decay, is_cut=i in cuts)
        assert max(0, i + 1 - look_ahead) <= len(found) <= i + 1
    return found + deflicker.finish()


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.floats(-0.1, 0.1), min_size=1, max_size=12),
    st.integers(0, 4),
    st.sets(st.integers(0, 11)),
)
def test_flickering_scale_becomes_its_mean_or_trend_around_each_frame(
    rises: list[float], look_ahead: int, cuts: set[int]
) -> None:
    cuts.add(0)
    image, base = noise(0), noise(1)
    logs = [base + np.float32(rise) for rise in rises]
    found = corrections([image] * len(rises), logs, look_ahead, cuts)
    assert len(found) == len(rises)
    for now, correction in enumerate(found):
        first = max([cut for cut in cuts if cut <= now] + [now - (look_ahead or now)])
        end = min([cut for cut in cuts if cut > now] + [len(rises), now + look_ahead + 1])
        times = np.arange(first, end) - now
        degree = 1 if look_ahead and len(times) > 1 else 0
        line = np.polyfit(times, rises[first:end], degree, w=0.8 ** (abs(times) / 2))
        np.testing.assert_allclose(correction.rise, line[-1] - rises[now], atol=1e-5)


def panned(count: int, step_px: int) -> tuple[list[Array], list[Array]]:
    """Images of a textured wall that a camera pans along and comes nearer to, and its depth."""
    wide = cv2.GaussianBlur(noise(2, (120, 400)), (0, 0), 3)
    wide = (wide - wide.min()) / np.ptp(wide)
    slope = np.tile(np.linspace(0, 1, 400, dtype=np.float32), (120, 1)) + (wide > 0.5)
    places = [slice(step_px * i, step_px * i + 160) for i in range(count)]
    return (
        [np.ascontiguousarray(wide[:, place]) for place in places],
        [slope[:, place] - np.float32(0.005 * i) for i, place in enumerate(places)],
    )


@pytest.mark.parametrize("step_px", [0, 1, 4])
def test_flicker_goes_from_depth_that_moves_and_a_true_change_stays(step_px: int) -> None:
    images, truth = panned(30, step_px)
    random, flicker = np.random.default_rng(0), []
    for _ in truth:  # of scale, and of one side against the other
        sides = random.normal(0, 0.02, 2)
        flicker.append(np.linspace(sides[0], sides[1], 160, dtype=np.float32))
    logs = [depth + rise for depth, rise in zip(truth, flicker, strict=True)]
    found = corrections(images, logs, 6, {0}, 0.85)
    steady = [
        values + cv2.resize(correction.rise, values.shape[::-1])
        for values, correction in zip(logs, found, strict=True)
    ]
    before, after = (np.subtract(maps, truth) for maps in (logs, steady))
    assert np.abs(np.diff(after, axis=0)).mean() < 0.35 * np.abs(np.diff(before, axis=0)).mean()
    assert abs(after[6:-6].mean()) < 0.005  # a camera that comes nearer, by 15 % in all
    steady_rise = [each.rise.mean() for each in corrections(images, truth, 6, {0}, 0.85)]
    assert np.abs(steady_rise).max() < 0.002  # also near both ends
    edges = [np.abs(np.diff(maps, axis=2)).mean() for maps in (truth, steady)]
    assert edges[1] == pytest.approx(edges[0], rel=0.03)


def test_noise_is_no_motion() -> None:
    (image,), (depth,) = panned(1, 0)
    grain = [image + 0.04 * (noise(seed, image.shape) - np.float32(0.5)) for seed in (5, 6)]
    assert corrections(grain, [depth] * 2, 0, {0})[1].stillness.mean() > 0.6
    moved, _ = panned(2, 1)
    assert corrections(moved, [depth] * 2, 0, {0})[1].stillness.mean() < 0.05


def test_holes_stay_holes_and_spread_to_nothing() -> None:
    smoother = Smoother()
    first, second = noise(0), noise(1)
    first[0, 0] = second[1, 1] = np.nan
    smoother.step(first, STATIC, STEADY, 0.9)
    smoothed = smoother.step(second, STATIC, STEADY, 0.9)
    assert np.isnan(smoothed[1, 1])
    assert smoothed[0, 0] == second[0, 0]
    assert np.isfinite(smoother.step(noise(2), STATIC, STEADY, 0.9)).all()


def test_flicker_is_the_mean_change_of_still_pixels() -> None:
    meter = FlickerMeter(DepthKind.METRIC)
    difference = noise(9) * np.float32(0.04)
    steps = [noise(seed) for seed in range(4)]
    changes = [Change(difference, is_cut=i in (0, 2)) for i in range(4)]
    for values, change in zip(steps, changes, strict=True):
        meter.step(values, change)
    found = [
        abs(float(steps[i][y, x]) - float(steps[i - 1][y, x]))
        for i in (1, 3)
        for y in range(12)
        for x in range(16)
        if difference[y, x] < 0.02
    ]
    assert found
    assert meter.value == pytest.approx(math.fsum(found) / len(found), abs=1e-6)


def test_flicker_of_one_frame_is_unknown_and_of_no_unit_is_scaled() -> None:
    meter = FlickerMeter(DepthKind.INVERSE)
    meter.step(noise(0), STATIC)
    assert meter.value is None
    scaled = FlickerMeter(DepthKind.INVERSE)
    scaled.step(noise(0) * 100, STATIC)
    for seed in range(3):
        meter.step(noise(seed), STATIC)
        scaled.step(noise(seed) * 100, STATIC)
    assert meter.value is not None
    assert scaled.value == pytest.approx(meter.value, rel=1e-5)


@pytest.mark.parametrize("kind", list(DepthKind))
def test_steps_go_there_and_back(kind: DepthKind) -> None:
    values = noise(0) + np.float32(0.1)
    values[0] = np.nan
    back = from_log(to_log(DepthMap(values, kind)), kind)
    np.testing.assert_allclose(back, values, rtol=1e-6)


def test_the_range_is_an_exponential_mean_of_logarithms() -> None:
    lock, decay = RangeLock(), 0.8
    low, high = lock.step(1.0, 10.0, decay)
    assert (low, high) == (1, 10)
    for own_low, own_high in [(2.0, 8.0), (0.5, 20.0), (1.0, 9.0)]:
        expected = low**decay * own_low ** (1 - decay), high**decay * own_high ** (1 - decay)
        low, high = lock.step(own_low, own_high, decay)
        assert (low, high) == pytest.approx(expected)
    assert lock.step(3.0, 4.0, decay, is_cut=True) == (3, 4)


def test_a_range_that_passes_zero_is_averaged_as_it_is() -> None:
    lock = RangeLock()
    lock.step(-1.0, 1.0, 0.25)
    assert lock.step(1.0, 2.0, 0.25) == pytest.approx((0.5, 2**0.75))


def test_without_a_time_constant_nothing_is_kept() -> None:
    assert ema_decay(0.1, 0) == 0
    assert ema_decay(0.1, 0.1) == pytest.approx(math.exp(-1))
    lock = RangeLock()
    lock.step(1.0, 2.0, 0)
    assert lock.step(5.0, 7.0, 0) == pytest.approx((5, 7))
