"""Cuts, motion, smoothing, flicker and range lock, against plain loops and known cases."""

import math
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import assume, example, given, settings, strategies as st

from depthcli.core.imageops import resize_bilinear
from depthcli.core.temporal import (
    Change,
    ChangeDetector,
    Correction,
    Deflicker,
    FlickerMeter,
    RangeLock,
    Smoother,
    ema_decay,
    from_log,
    sample_cells,
    thumbnail,
    to_log,
)
from depthcli.core.types import DepthKind, DepthMap

Array = np.ndarray[Any, np.dtype[np.float32]]


def noise(seed: int, shape: tuple[int, ...] = (12, 16)) -> Array:
    return np.random.default_rng(seed).random(shape, np.float32)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 9), st.integers(1, 9))
def test_a_difference_is_that_of_means_over_25_pixels(seed: int, height: int, width: int) -> None:
    values = noise(seed, (height, width))
    around = np.pad(values, 2, "edge")
    means = [around[y : y + 5, x : x + 5].mean() for y, x in np.ndindex(height, width)]
    expected = np.reshape(means, (height, width))
    changes = ChangeDetector()
    changes.step(np.zeros_like(values))
    np.testing.assert_allclose(changes.step(values).difference, expected, atol=1e-6)


def test_stillness_takes_the_largest_change_nearby() -> None:
    difference = noise(3) * np.float32(0.09)
    still, around = Change(difference, is_cut=False).static_weight, np.pad(difference, 1, "edge")
    for y, x in np.ndindex(12, 16):
        near = around[y : y + 3, x : x + 3].max()
        assert still[y, x] == pytest.approx(1 - min(near / 0.06, 1), abs=1e-5)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_a_guide_is_brightness_at_a_bounded_size(dtype: type) -> None:
    top = 1 if dtype is np.float32 else np.iinfo(dtype).max
    pixels = np.full((300, 600, 3), top, dtype)
    small = thumbnail(pixels)
    assert small.shape == (96, 192)
    np.testing.assert_allclose(small, 1, atol=1e-5)
    assert thumbnail(pixels[:7, :9, 0]).shape == (7, 9)
    assert thumbnail(pixels[:1]).shape == thumbnail(pixels[:, :1]).T.shape == (1, 192)


@given(st.lists(st.floats(0, 0.45), max_size=30))
@example([0.07] * 9 + [0.15, 0.25])
def test_cuts_are_those_of_a_plain_loop(steps: list[float]) -> None:
    changes, level, usual = ChangeDetector(), 0.5, 0.0
    assert changes.step(np.full((8, 8), level, np.float32)).is_cut  # the first image
    for size in steps:
        bound = max(0.08, 3 * usual)
        assume(abs(size - bound) > 1e-4)
        level += size if level < 0.5 else -size  # to and fro, within [0, 1]
        assert changes.step(np.full((8, 8), level, np.float32)).is_cut == (size > bound)
        usual = 0.0 if size > bound else 0.8 * usual + 0.2 * size
    assert ChangeDetector().step(noise(0)).difference.min() == 1


def test_smoothing_is_that_of_a_plain_loop() -> None:
    """The past counts less where the image changes or moves, and not at a cut."""
    smoother, before = Smoother(), noise(0)
    for number in range(8):
        values, rise, stillness = (noise(number, (12, 16)), *noise(50 + number, (2, 3, 4)))
        values[noise(20 + number) < 0.1] = np.nan
        change = Change(noise(40 + number, (6, 8)) * np.float32(0.08), is_cut=number == 5)
        still = resize_bilinear(stillness, 8, 6) * change.static_weight
        share = math.exp(-0.1 / 0.9) * resize_bilinear(still, 16, 12)
        expected = values + resize_bilinear(rise, 16, 12)
        if number not in (0, 5):
            for place in np.ndindex(12, 16):  # holes stay, and spread to nothing
                step = before[place] - expected[place]
                expected[place] += share[place] * (step if np.isfinite(before[place]) else 0)
        decay = ema_decay(0.1, 0.9)
        before = smoother.step(values, change, Correction(rise, stillness), decay)
        np.testing.assert_allclose(before, expected, rtol=1e-5)
    small = smoother.step(before[:6], change, Correction(rise, stillness), 0.9)
    np.testing.assert_allclose(small, before[:6] + resize_bilinear(rise, 16, 6))


def corrections(
    images: list[Array], logs: list[Array], look_ahead: int, cuts: set[int], decay: float = 0.8
) -> list[Correction]:
    deflicker, per_frame = Deflicker(look_ahead), []
    for i, (image, values) in enumerate(zip(images, logs, strict=True)):
        per_frame += deflicker.step(image, values, decay, is_cut=i in cuts)
        assert max(0, i + 1 - look_ahead) <= len(per_frame) <= i + 1
    return per_frame + deflicker.finish()


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
    per_frame = corrections([image] * len(rises), logs, look_ahead, cuts)
    assert len(per_frame) == len(rises)
    for now, correction in enumerate(per_frame):
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
    per_frame = corrections(images, logs, 6, {0}, 0.85)
    steady = [
        values + cv2.resize(correction.rise, values.shape[::-1])
        for values, correction in zip(logs, per_frame, strict=True)
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
    assert corrections(grain, [depth] * 2, 0, {0})[1].stillness.mean() > 0.8
    moved, _ = panned(2, 1)
    assert corrections(moved, [depth] * 2, 0, {0})[1].stillness.mean() < 0.05


def gauss(values: Array) -> Array:
    """A Gaussian of one pixel, the edges repeated; in a plain loop."""
    weights = np.exp(-(np.arange(-4, 5) ** 2) / 2)
    around = np.pad(values, 4, "edge")
    window = weights[:, None] * weights / weights.sum() ** 2
    mean = [(around[y : y + 9, x : x + 9] * window).sum() for y, x in np.ndindex(values.shape)]
    return np.reshape(mean, values.shape)


def test_change_between_two_frames_is_that_of_a_plain_loop() -> None:
    """In images too small for optical flow, of 3×3 pixels that have depth both times."""
    image, first, second = noise(0, (21, 30)), noise(1, (21, 30)), noise(2, (21, 30))
    first[3:20, :18] = second[2:20, :18] = second[-1] = second[:, -1] = np.nan
    rise, stillness = corrections([image] * 2, [first, second], 0, {0}, 0.25)[1]
    change = (first - second).reshape(7, 3, 10, 3)
    total, share = np.nan_to_num(change).mean((1, 3)), np.isfinite(change).mean((1, 3))
    expected = gauss(total) / np.maximum(gauss(share), 0.02)
    assert (gauss(share) < 0.02).any()
    np.testing.assert_allclose(rise, 0.25 * expected / (1 + 0.25), atol=1e-6)
    np.testing.assert_array_equal(stillness, 1)


@pytest.mark.parametrize("shape", [(2, 2), (3, 192), (31, 40), (32, 32)])
def test_images_of_any_size_are_steadied(shape: tuple[int, int]) -> None:
    image, logs = noise(0, shape), [noise(1, shape), noise(1, shape) + np.float32(0.1)]
    for correction, rise in zip(corrections([image] * 2, logs, 0, {0}), (0, 0.1), strict=True):
        assert correction.rise.shape == tuple(max(1, size // 3) for size in shape)
        np.testing.assert_allclose(correction.rise, rise * -0.8 / 1.8, atol=1e-5)


@pytest.mark.parametrize("kind", DepthKind)
def test_flicker_is_the_mean_change_of_still_pixels(kind: DepthKind) -> None:
    meter, before, changes = FlickerMeter(kind), noise(0), []
    for number in range(6):
        values = noise(number) * (number != 3)  # without a range
        values[2, number] = np.nan
        difference = noise(20 + number) * np.float32(0.04)
        difference[0, :2] = np.nextafter(np.float32(0.02), np.float32(0)), 0.02
        meter.step(values, Change(difference, is_cut=number == 2))
        if number in (0, 2):
            assert (meter.value is None) == (number == 0)
        else:
            is_unscaled = kind is DepthKind.METRIC or number == 3
            unit = 1.0 if is_unscaled else np.nanmax(values) - np.nanmin(values)
            changes += [
                abs(values[place] - before[place]) / unit
                for place in np.ndindex(12, 16)
                if difference[place] < np.float32(0.02)
            ]
        before = values
    assert meter.value == pytest.approx(np.nanmean(changes), rel=1e-5)


def test_a_sample_is_the_middle_of_each_cell() -> None:
    values = np.arange(48, dtype=np.float32).reshape(6, 8)
    np.testing.assert_array_equal(sample_cells(values, (2, 4)), [[9, 11, 13, 15], [33, 35, 37, 39]])


@pytest.mark.parametrize("kind", list(DepthKind))
def test_steps_go_there_and_back(kind: DepthKind) -> None:
    values = noise(0) + np.float32(0.1)
    values[0, :3] = np.nan, 0, -1
    with np.errstate(all="raise"):  # nor a word of what has no logarithm
        back = from_log(to_log(DepthMap(values, kind)), kind)
    values[0, 1:3] = (np.nan, np.nan) if kind is DepthKind.METRIC else (0, -1)
    np.testing.assert_allclose(back, values, rtol=1e-6)


def test_ends_of_the_range_are_means_of_logarithms_where_both_are_positive() -> None:
    lock, before = RangeLock(), (1.0, 10.0)
    assert lock.step(*before, 0.8) == before
    for ends in [(2.0, 8.0), (0.5, 20.0), (0.0, 9.0), (1.0, 7.0), (-1.0, 0.0), (3.0, 5.0)]:
        expected = [
            old**0.8 * new**0.2 if old > 0 and new > 0 else 0.8 * old + 0.2 * new
            for old, new in zip(before, ends, strict=True)
        ]
        before = lock.step(*ends, 0.8)
        assert before == pytest.approx(expected)
    assert lock.step(3.0, 4.0, 0.8, is_cut=True) == (3, 4)
    assert lock.step(-1.0, 7.0, ema_decay(0.1, 0)) == pytest.approx((-1, 7))
