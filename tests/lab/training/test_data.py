"""Batches and stored pairs: seed and step alone decide them, and holes do not count."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from helpers.rooms import HELD_OUT, PAPER, TRAIN, batches_of, rooms

from depthcli.errors import DatasetError
from depthcli.lab.training.augment import Views, augment
from depthcli.lab.training.config import PromptConfig
from depthcli.lab.training.data import (
    Batches,
    PairStore,
    _stored_size,
    downsample,
    drawn_prompt,
    drawn_prompts,
    whole_images,
)
from depthcli.lab.training.provenance import train_val_split

DATA = replace(PAPER.data, zoom=1.5, rotate_deg=5, gamma=0.2, brightness=0.2, noise=0.02)


def _batches(size: int = 2, seed: int = 0, **changes: object) -> Batches:
    data = replace(DATA, **changes)
    return batches_of(PairStore(rooms(), TRAIN, data), data, size, seed)


def test_an_epoch_shows_every_pair_once_in_an_order_of_its_own() -> None:
    batches = _batches(size=1)
    assert batches.steps_per_epoch == 5
    orders = [
        [int(batches._rows(batches.store, 5 * e + i, 1, stream=2)) for i in range(5)]
        for e in range(4)
    ]
    assert all(sorted(order) == list(range(5)) for order in orders)
    assert len({tuple(order) for order in orders}) > 1


def test_last_incomplete_batch_is_dropped_and_large_ones_shrink() -> None:
    assert _batches(size=2).steps_per_epoch == 2
    large = _batches(size=99)
    assert (large.batch_size, large.steps_per_epoch) == (5, 1)


def test_unpaired_depth_is_of_other_scenes() -> None:
    plain = {"zoom": 1.0, "gamma": 0.0, "brightness": 0.0, "noise": 0.0, "rotate_deg": 0.0}
    paired, unpaired = _batches(size=5, **plain), _batches(size=5, paired=False, **plain)
    assert torch.equal(paired[0].network_input, unpaired[0].network_input)
    assert not torch.equal(paired[0].depth_m, unpaired[0].depth_m)
    alike = [
        any(torch.equal(a, b) or torch.equal(a, b.flip(2)) for b in paired[0].depth_m)
        for a in unpaired[0].depth_m
    ]
    assert all(alike)  # the same five scenes, in another order
    in_place = [
        torch.equal(a, b) or torch.equal(a, b.flip(2))
        for a, b in zip(unpaired[0].depth_m, paired[0].depth_m, strict=True)
    ]
    assert not all(in_place)


def test_whole_images_are_not_augmented() -> None:
    store = PairStore(rooms(), HELD_OUT, DATA)
    (gray,) = whole_images(store, DATA, torch.tensor([0]))
    expected = torch.nn.functional.avg_pool2d(store.rgb.float(), 2).amax(1) / 255 * 2 - 1
    torch.testing.assert_close(gray, expected)


def test_whole_scenes_are_held_out() -> None:
    dataset = rooms()
    assert train_val_split(dataset, DATA) == (TRAIN, HELD_OUT)
    assert train_val_split(dataset, replace(DATA, holdout_every=0)) == (list(range(6)), [])
    for offset in range(4):
        train, held_out = train_val_split(
            dataset, replace(DATA, holdout_every=2, holdout_offset=offset)
        )
        assert sorted(train + held_out) == list(range(6))
        scenes = [{dataset.scenes[i] for i in rows} for rows in (train, held_out)]
        assert not scenes[0] & scenes[1]


def test_no_pair_is_an_error() -> None:
    with pytest.raises(DatasetError):
        PairStore(rooms(), [], DATA)


@pytest.mark.parametrize(
    ("image", "stored"),
    [
        ((300, 100), (150, 300)),
        ((150, 130), (130, 260)),
        ((900, 900), (200, 400)),
        ((9, 9), (100, 200)),
    ],
)
def test_images_are_kept_as_views_need(image: tuple[int, int], stored: tuple[int, int]) -> None:
    """At the network's aspect, as large as the image along one axis, at most twice the size."""
    width, height = _stored_size((*image, 3), replace(DATA, width=100, height=200))
    assert (width, height) == stored


HOLED_DATA = replace(PAPER.data, zoom=1.5, rotate_deg=5, gamma=0.2)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -1.0])
def test_resizing_takes_the_mean_of_what_was_measured(value: float) -> None:
    depth_m = np.float32([[2, 4, 3, value], [value, 6, value, value]])
    (small_m,), (valid_mask,) = downsample(depth_m, (2, 1))
    assert small_m.tolist() == [4.0, 4.0]  # the hole takes its neighbour's, not half of 3
    assert valid_mask.tolist() == [True, False]


@pytest.mark.parametrize(("width", "columns"), [(2, 1), (49, 2), (53, 2), (12, 5), (41, 1)])
def test_a_pixel_is_measured_from_exactly_half_of_its_area_on(width: int, columns: int) -> None:
    half_m = np.zeros((2, width), np.float32)
    half_m[0] = 3.0
    shrunk = downsample(half_m, (columns, 1))
    assert shrunk[1] is None
    np.testing.assert_allclose(shrunk[0], 3.0, rtol=1e-5)
    less_m = np.zeros((5, width), np.float32)
    less_m[:2] = 3.0
    assert downsample(less_m, (columns, 1)) is None


def test_holes_take_the_nearest_measurement() -> None:
    depth_m = np.zeros((5, 9), np.float32)
    depth_m[2, 0], depth_m[2, 8] = 1.0, 7.0
    filled_m, valid_mask = downsample(depth_m, (9, 5))
    assert (filled_m[:, :4] == 1).all()
    assert (filled_m[:, 5:] == 7).all()
    assert int(valid_mask.sum()) == 2


def test_without_holes_nothing_changes() -> None:
    depth_m = rooms().depths_m[0]
    small_m, valid_mask = downsample(depth_m, (32, 24))
    assert valid_mask is None
    assert np.array_equal(small_m, cv2.resize(depth_m, (32, 24), interpolation=cv2.INTER_AREA))


def test_without_a_measurement_there_is_nothing() -> None:
    assert downsample(np.zeros((4, 4), np.float32), (2, 2)) is None
    dataset = rooms()
    empty = replace(
        dataset, depths_m=dataset.depths_m * np.float32([1, 1, 1, 0, 1, 1])[:, None, None]
    )
    with pytest.raises(DatasetError):
        PairStore(empty, TRAIN, HOLED_DATA)


def test_batches_never_show_zero_and_say_what_is_known() -> None:
    """Of the rooms with holes in blocks of 4 x 4 pixels."""
    dataset = rooms()
    holes = (np.random.default_rng(0).random((6, 12, 16)) < 0.2).repeat(4, 1).repeat(4, 2)
    holed = replace(dataset, depths_m=np.where(holes, np.float32(0), dataset.depths_m))
    store = PairStore(holed, TRAIN, HOLED_DATA)
    assert store.valid_mask is not None
    assert float(store.depth_m.min()) >= 0.9
    for changes in ({}, {"paired": False}, {"crop_286": True}):
        data = replace(HOLED_DATA, **changes)
        gray, depth_m, valid_mask, *_ = batches_of(store, data, 5)[0]
        assert valid_mask.shape == depth_m.shape == gray.shape
        assert valid_mask.dtype == torch.bool
        assert 0.4 < float(valid_mask.float().mean()) < 0.95
        assert float(depth_m.min()) > 0.9 / 1.5


def test_known_pixels_have_the_depth_of_the_image_without_holes() -> None:
    """Holes at the stored size, so that only the view mixes pixels."""
    whole_m = torch.rand(6, 1, 64, 64, generator=torch.Generator().manual_seed(1)) * 5 + 1
    valid_mask = torch.rand(6, 1, 64, 64, generator=torch.Generator().manual_seed(2)) > 0.05
    rgb = torch.rand(6, 3, 64, 64)
    whole = augment(rgb, whole_m, HOLED_DATA, torch.Generator().manual_seed(3))
    with_holes = torch.where(valid_mask, whole_m, torch.full_like(whole_m, 99))
    holed = augment(rgb, with_holes, HOLED_DATA, torch.Generator().manual_seed(3), valid_mask)
    assert whole.valid_mask is None
    assert holed.valid_mask is not None
    assert torch.equal(whole.network_input, holed.network_input)
    torch.testing.assert_close(
        holed.depth_m[holed.valid_mask], whole.depth_m[holed.valid_mask], rtol=0, atol=0.11
    )
    wrong = (holed.depth_m - whole.depth_m).abs() > 0.5
    assert not (wrong & holed.valid_mask).any()
    assert wrong.any()


COUNT, ROWS, COLUMNS = 24, 96, 128


def test_each_view_has_points_of_its_measured_depth_and_the_seed_decides_them() -> None:
    config = PromptConfig(exact=1, jitter_px=0, missing=0)
    rows, columns = torch.meshgrid(torch.arange(ROWS), torch.arange(COLUMNS), indexing="ij")
    depth_m = torch.arange(1, COUNT + 1).view(-1, 1, 1, 1) + rows / 100
    boxes = ((rows // 12 + columns // 16) % 2).float().expand(COUNT, 3, -1, -1)
    views = Views(boxes, depth_m, (columns < COLUMNS // 2).expand(COUNT, 1, -1, -1))
    prompts = drawn_prompts(views, config, np.random.SeedSequence(3))
    valid = prompts > 0
    assert valid.any(dim=3).any(dim=2).sum() > COUNT / 2  # a far view has none of a depth camera
    assert torch.equal(prompts[valid], views.depth_m[valid])
    assert views.valid_mask is not None
    assert not valid[~views.valid_mask].any()
    assert torch.equal(prompts, drawn_prompts(views, config, np.random.SeedSequence(3)))
    assert not torch.equal(prompts, drawn_prompts(views, config, np.random.SeedSequence(4)))
    nothing = views._replace(valid_mask=torch.zeros_like(views.valid_mask))
    assert not drawn_prompts(nothing, config, np.random.SeedSequence(3)).any()


def test_config_decides_patterns_sizes_and_how_many_are_exact() -> None:
    random = np.random.default_rng(0)
    config = PromptConfig(("uniform", "lidar"), (5, 50), lines=(64, 99), exact=0.25, missing=0.5)
    drawn = [drawn_prompt(config, random) for _ in range(400)]
    exact = [not (prompt.noise or prompt.wrong or prompt.has_kinect_noise) for prompt in drawn]
    assert 0.25 < np.mean(exact) < 0.5
    assert abs(np.mean([prompt.part != (0, 0, 1, 1) for prompt in drawn]) - 0.5) < 0.1
    sizes = {
        pattern: {prompt.size for prompt in drawn if prompt.pattern == pattern}
        for pattern in config.patterns
    }
    assert sizes["lidar"] == {64, 99}
    ranges_m = [prompt.range_m for prompt in drawn]
    assert 2.5 < min(ranges_m) < 2.6
    assert 7.8 < max(ranges_m) < 8
    assert min(sizes["uniform"]) in {5, 6}
    assert 45 < max(sizes["uniform"]) <= 50
