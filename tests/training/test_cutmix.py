"""CutMix against a plain loop: one rectangle of the neighbour, the same in every map."""

from dataclasses import replace

import torch
from helpers.seeded import seeded
from torch import Tensor

from depthcli.training.augment import augment, cutmix
from depthcli.training.config import DataConfig

COUNT, HEIGHT, WIDTH = 50, 24, 32


def _numbered(count: int = COUNT) -> Tensor:
    """(count, 1, H, W) whose every pixel is the number of its view."""
    return torch.arange(float(count)).view(-1, 1, 1, 1).expand(-1, 1, HEIGHT, WIDTH).contiguous()


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
    (mixed,) = cutmix([_numbered()], 0.999999, seeded())
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


def test_the_rectangles_lie_everywhere() -> None:
    (mixed,) = cutmix([_numbered(2000)], 0.999999, seeded(1))
    pasted = (mixed != _numbered(2000)).float().mean((0, 1))
    assert float(pasted.min()) > 0
    assert float(pasted[HEIGHT // 2, WIDTH // 2]) > 0.4
    assert float((pasted - pasted.flip(0, 1)).abs().max()) < 0.1


def test_all_maps_get_the_same_rectangles_and_keep_their_type() -> None:
    gray = torch.rand(COUNT, 1, HEIGHT, WIDTH, generator=seeded(2))
    maps = [gray, 3 * gray, gray < 0.5]
    first, second, third = cutmix(maps, 0.5, seeded(3))
    assert not torch.equal(first, gray)
    assert torch.equal(second, 3 * first)
    assert third.dtype == torch.bool
    assert torch.equal(third, first < 0.5)


def test_the_share_is_that_of_the_views() -> None:
    numbered = _numbered(2000)
    (mixed,) = cutmix([numbered], 0.3, seeded(4))
    changed = (mixed != numbered).any(3).any(2).float().mean()
    assert 0.26 < float(changed) < 0.34


def test_augmentation_mixes_picture_and_depth_alike() -> None:
    value = torch.rand(8, 1, 48, 64, generator=seeded(5))
    rgb, depth_m = value.expand(-1, 3, -1, -1).contiguous(), 1 + 4 * value
    plain = DataConfig(width=WIDTH, height=HEIGHT)
    gray, seen_m, _ = augment(rgb, depth_m.clone(), plain, seeded(6))
    mixed, mixed_m, valid_mask = augment(
        rgb, depth_m.clone(), replace(plain, cutmix=0.9), seeded(6)
    )
    torch.testing.assert_close(mixed_m, 1 + 4 * (mixed + 1) / 2)
    assert valid_mask is None
    assert not torch.equal(mixed, gray)
    own = mixed == gray
    torch.testing.assert_close(mixed_m[own], seen_m[own])


def test_a_pasted_piece_brings_its_holes_along() -> None:
    """What is valid is where the picture is bright, before and after pieces are pasted."""
    value = torch.rand(8, 1, HEIGHT, WIDTH, generator=seeded(5))
    rgb, depth_m, valid_mask = value.expand(-1, 3, -1, -1).contiguous(), 1 + 4 * value, value > 0.4
    plain = DataConfig(width=WIDTH, height=HEIGHT)
    whole = augment(rgb, depth_m.clone(), plain, seeded(6), valid_mask)
    mixed = augment(rgb, depth_m.clone(), replace(plain, cutmix=0.9), seeded(6), valid_mask)
    for views in (whole, mixed):
        assert views.valid_mask is not None
        assert torch.equal(views.valid_mask, views.network_input > 2 * 0.4 - 1)
    assert not torch.equal(whole.valid_mask, mixed.valid_mask)
