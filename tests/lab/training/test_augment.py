"""Augmentation: the same geometry for image and depth, metres that stay true, and CutMix."""

import math
from dataclasses import replace

import pytest
import torch
from helpers.seeded import seeded
from torch import Tensor

from depthcli.lab.training.augment import augment, cutmix
from depthcli.lab.training.config import DataConfig

PLAIN = DataConfig(width=32, height=24)
FREE_OF_LIGHT = replace(PLAIN, zoom=2.0, rotate_deg=8)


def _pairs(count: int, *, noise: bool = True) -> tuple[Tensor, Tensor]:
    """Pairs whose depth, 1 to 5 m, is 1 + 4 V, so that each tells what the other must be."""
    rows, columns = torch.meshgrid(
        torch.linspace(0, 1, 48), torch.linspace(0, 1, 64), indexing="ij"
    )
    value = (0.2 * rows + 0.5 * columns).expand(count, 1, -1, -1).clone()
    if noise:
        value = value + 0.3 * torch.rand(value.shape, generator=seeded(9))
    return value.expand(-1, 3, -1, -1).contiguous(), 1 + 4 * value


def test_without_strengths_there_are_whole_images_and_mirrored_ones() -> None:
    rgb, depth_m = _pairs(1)
    rgb, depth_m = rgb.expand(64, -1, -1, -1), depth_m.expand(64, -1, -1, -1)
    gray, seen_m, _ = augment(rgb, depth_m, PLAIN, seeded())
    halves = torch.nn.functional.avg_pool2d(depth_m[:1], 2)
    mirrored = gray[..., 0].mean((1, 2)) > gray[..., -1].mean((1, 2))  # darker to the right
    assert 20 < int(mirrored.sum()) < 44
    for i in range(64):
        expected = halves.flip(3) if mirrored[i] else halves
        torch.testing.assert_close(seen_m[i : i + 1], expected)
        torch.testing.assert_close((gray[i : i + 1] + 1) / 2, (expected - 1) / 4)


def test_image_and_depth_keep_the_same_geometry() -> None:
    rgb, depth_m = _pairs(40)
    gray, seen_m, _ = augment(rgb, depth_m, FREE_OF_LIGHT, seeded(1))
    zoom = (1 + 4 * (gray + 1) / 2) / seen_m
    spread = zoom.amax((1, 2, 3)) - zoom.amin((1, 2, 3))
    assert float(spread.max()) < 1e-4  # one zoom everywhere in an image
    zooms = zoom.mean((1, 2, 3))
    assert 0.1 < float((zooms < 1.0001).float().mean()) < 0.5  # whole images stay among them
    assert float(zooms.min()) > 0.9999
    assert 1.6 < float(zooms.max()) <= 2.0001


def test_crop_of_the_originals_is_untrue_to_metres() -> None:
    rgb, depth_m = _pairs(50)
    gray, seen_m, _ = augment(rgb, depth_m, replace(PLAIN, crop_286=True), seeded(6))
    torch.testing.assert_close(1 + 4 * (gray + 1) / 2, seen_m)
    _, plane_m, _ = augment(rgb, torch.full_like(depth_m, 3.0), PLAIN, seeded(6))
    torch.testing.assert_close(plane_m, torch.full_like(plane_m, 3.0))
    means = seen_m.mean((1, 2, 3))
    assert float(means.max() - means.min()) > 0.05  # crops at random places


@pytest.mark.parametrize(
    "strengths",
    [
        {"colour_jitter": 0.2},
        {"gamma": 0.3},
        {"brightness": 0.3},
        {"noise": 0.05},
        {"colour_jitter": 0.2, "gamma": 0.3, "brightness": 0.3, "noise": 0.05},
    ],
)
def test_light_changes_the_image_and_never_the_depth(strengths: dict[str, float]) -> None:
    rgb, depth_m = _pairs(8)
    lit = replace(PLAIN, **strengths)
    gray, seen_m, _ = augment(rgb, depth_m, PLAIN, seeded(7))
    relit, same_m, _ = augment(rgb, depth_m, lit, seeded(7))
    torch.testing.assert_close(seen_m, same_m)
    assert float((gray - relit).abs().mean((1, 2, 3)).mean()) > 0.01
    assert float(relit.min()) >= -1
    assert float(relit.max()) <= 1


def _lit(level: float, **strengths: float) -> Tensor:
    """V of 1,000 views of a red image, (1000, 24, 32)."""
    rgb = torch.zeros(1000, 3, 24, 32)
    rgb[:, 0] = level
    data = replace(PLAIN, **strengths)
    return (augment(rgb, torch.ones(1000, 1, 24, 32), data, seeded(7)).network_input[:, 0] + 1) / 2


def test_strengths_are_standard_deviations() -> None:
    gain = _lit(0.5, colour_jitter=0.05)[:, 0, 0] / 0.5
    exponent = _lit(0.5, gamma=0.2)[:, 0, 0].log() / math.log(0.5)
    for drawn, strength in ((gain.log(), 0.05), (exponent.log(), 0.2)):
        assert float(drawn.std()) == pytest.approx(strength, rel=0.1)
        assert abs(float(drawn.mean())) < 0.1 * strength
    for level in (0.25, 0.5):  # a gain, and a quarter of it as an offset
        bright = _lit(level, brightness=0.1)[:, 0, 0]
        assert float(bright.std()) == pytest.approx(math.hypot(0.1 * level, 0.025), rel=0.1)
        assert float(bright.mean()) == pytest.approx(level, abs=0.01)
    noise = _lit(0.5, noise=0.1)
    deviations = noise.std((1, 2))
    assert float(deviations.mean()) == pytest.approx(0.05, rel=0.1)
    assert float(deviations.max()) == pytest.approx(0.1, rel=0.1)
    assert float(noise.mean()) == pytest.approx(0.5, abs=1e-3)
    assert float(_lit(1e-6, gamma=0.2).log().mean()) == pytest.approx(math.log(1e-4), rel=0.05)


COUNT, HEIGHT, WIDTH = 50, 24, 32


def _rectangle(inside: Tensor) -> tuple[int, int]:
    """(height, width) of the rectangle that (H, W) bool is True in, and nowhere else."""
    rows, columns = torch.nonzero(inside, as_tuple=True)
    top, bottom = int(rows.min()), int(rows.max()) + 1
    left, right = int(columns.min()), int(columns.max()) + 1
    for y in range(HEIGHT):
        for x in range(WIDTH):
            assert bool(inside[y, x]) == (top <= y < bottom and left <= x < right)
    return bottom - top, right - left


def test_each_view_gets_one_rectangle_of_the_view_before_it() -> None:
    numbers = torch.arange(float(COUNT)).view(-1, 1, 1, 1).expand(-1, 1, HEIGHT, WIDTH)
    (mixed,) = cutmix([numbers.contiguous()], 0.999999, seeded())
    sides = set()
    for number in range(COUNT):
        view = mixed[number, 0]
        inside = view != number
        assert view[inside].unique().tolist() == [(number - 1) % COUNT]
        height, width = _rectangle(inside)
        assert HEIGHT // 4 - 1 <= height <= HEIGHT * 3 // 4 + 1
        assert WIDTH // 4 - 1 <= width <= WIDTH * 3 // 4 + 1
        sides.add((height, width))
    assert len(sides) > COUNT // 2


def test_all_maps_get_the_same_rectangles_and_keep_their_type() -> None:
    gray = torch.rand(COUNT, 1, HEIGHT, WIDTH, generator=seeded(2))
    maps = [gray, 3 * gray, gray < 0.5]
    first, second, third = cutmix(maps, 0.5, seeded(3))
    assert not torch.equal(first, gray)
    assert torch.equal(second, 3 * first)
    assert third.dtype == torch.bool
    assert torch.equal(third, first < 0.5)


def test_a_pasted_piece_brings_its_holes_along() -> None:
    """What is valid is where the image is bright, before and after pieces are pasted."""
    value = torch.rand(8, 1, HEIGHT, WIDTH, generator=seeded(5))
    rgb, depth_m, valid_mask = value.expand(-1, 3, -1, -1).contiguous(), 1 + 4 * value, value > 0.4
    plain = DataConfig(width=WIDTH, height=HEIGHT)
    whole = augment(rgb, depth_m.clone(), plain, seeded(6), valid_mask)
    mixed = augment(rgb, depth_m.clone(), replace(plain, cutmix=0.9), seeded(6), valid_mask)
    for views in (whole, mixed):
        assert views.valid_mask is not None
        assert torch.equal(views.valid_mask, views.network_input > 2 * 0.4 - 1)
    assert not torch.equal(whole.valid_mask, mixed.valid_mask)
