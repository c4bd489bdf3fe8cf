"""Holes in depth: they neither count nor mix with what was measured."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from helpers.rooms import PAPER, TRAIN, rooms
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.errors import DatasetError
from depthcli.training.augment import augment
from depthcli.training.data import Batches, PairStore, downsample
from depthcli.training.losses import gradient_loss, regularized_l1

DATA = replace(PAPER.data, zoom=1.5, rotate_deg=5, gamma=0.2)


def _holed(share: float = 0.2, value: float = 0.0, seed: int = 0) -> Any:
    """The rooms with holes in blocks of 4 x 4 pixels."""
    dataset, rng = rooms(), np.random.default_rng(seed)
    coarse = rng.random((len(dataset), 12, 16)) < share
    holes = coarse.repeat(4, 1).repeat(4, 2)
    return replace(dataset, depths_m=np.where(holes, np.float32(value), dataset.depths_m))


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
    assert shrunk is not None
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
        PairStore(empty, TRAIN, DATA)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 999), share=st.floats(0.05, 0.9), factor=st.sampled_from([1, 2, 3]))
def test_no_value_is_outside_of_what_was_measured(seed: int, share: float, factor: int) -> None:
    depth_m = _holed(share, seed=seed).depths_m[0]
    shrunk = downsample(depth_m, (64 // factor, 48 // factor))
    if shrunk is not None:
        measured_m = depth_m[depth_m > 0]
        assert shrunk[0].min() >= measured_m.min() - 1e-5
        assert shrunk[0].max() <= measured_m.max() + 1e-5


def test_batches_never_show_zero_and_say_what_is_known() -> None:
    store = PairStore(_holed(), TRAIN, DATA)
    assert store.valid_mask is not None
    assert float(store.depth_m.min()) >= 0.9
    for changes in ({}, {"paired": False}, {"crop_286": True}):
        data = replace(DATA, **changes)
        gray, depth_m, valid_mask, _ = Batches(store, data, 5, 0, torch.device("cpu"))[0]
        assert valid_mask is not None
        assert valid_mask.shape == depth_m.shape == gray.shape
        assert valid_mask.dtype == torch.bool
        assert 0.4 < float(valid_mask.float().mean()) < 0.95
        assert float(depth_m.min()) > 0.9 / 1.5


def test_known_pixels_have_the_depth_of_the_picture_without_holes() -> None:
    """Holes at the stored size, so that only the view mixes pixels."""
    whole_m = torch.rand(6, 1, 64, 64, generator=torch.Generator().manual_seed(1)) * 5 + 1
    valid_mask = torch.rand(6, 1, 64, 64, generator=torch.Generator().manual_seed(2)) > 0.05
    rgb = torch.rand(6, 3, 64, 64)
    seen = augment(rgb, whole_m, DATA, torch.Generator().manual_seed(3))
    with_holes = torch.where(valid_mask, whole_m, torch.full_like(whole_m, 99))
    holed = augment(rgb, with_holes, DATA, torch.Generator().manual_seed(3), valid_mask)
    assert seen.valid_mask is None
    assert holed.valid_mask is not None
    assert torch.equal(seen.network_input, holed.network_input)
    torch.testing.assert_close(
        holed.depth_m[holed.valid_mask], seen.depth_m[holed.valid_mask], rtol=0, atol=0.11
    )
    wrong = (holed.depth_m - seen.depth_m).abs() > 0.5
    assert not (wrong & holed.valid_mask).any()
    assert wrong.any()


def _pair(seed: int = 4) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(seed)
    prediction, truth, chance = (torch.rand(2, 1, 16, 24, generator=random) for _ in range(3))
    return prediction, truth, chance > 0.1


def test_l1_is_the_mean_over_known_pixels() -> None:
    prediction, truth, valid_mask = _pair()
    wanted = (prediction - truth).abs()[valid_mask].mean()
    loss = regularized_l1(prediction, truth, torch.nn.Module(), 0, valid_mask)
    torch.testing.assert_close(loss, wanted)
    nothing = regularized_l1(prediction, truth, torch.nn.Module(), 0, valid_mask & False)
    assert float(nothing) == 0


def _difference(error: Any, valid_mask: Any, step: tuple[int, int]) -> float:
    """Mean difference of neighbours, both valid, by plain loops."""
    found = []
    images, _, rows, columns = valid_mask.shape
    for b in range(images):
        for y in range(rows - step[0]):
            for x in range(columns - step[1]):
                there = (b, 0, y + step[0], x + step[1])
                if valid_mask[b, 0, y, x] and valid_mask[there]:
                    found.append(abs(float(error[there]) - float(error[b, 0, y, x])))
    return float(np.mean(found)) if found else 0.0


def test_gradient_loss_is_of_differences_between_known_pixels() -> None:
    prediction, truth, valid_mask = _pair()
    error, mask, terms = (prediction - truth).numpy(), valid_mask.numpy(), []
    for _ in range(4):
        terms.append(_difference(error, mask, (0, 1)) + _difference(error, mask, (1, 0)))
        rows, columns = error.shape[2] // 2, error.shape[3] // 2
        error, mask = (m[:, :, : 2 * rows, : 2 * columns] for m in (error, mask))
        blocks = (len(error), 1, rows, 2, columns, 2)
        error, mask = error.reshape(blocks).mean((3, 5)), mask.reshape(blocks).all((3, 5))
    found = gradient_loss(prediction, truth, valid_mask)
    assert float(found) == pytest.approx(float(np.mean(terms)), rel=1e-5)
