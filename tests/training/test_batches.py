"""Batches: what they hold, and that seed and step alone decide them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.rooms import HEIGHT, HELD_OUT, PAPER, TRAIN, WIDTH, Rooms, rooms

from depthcli.errors import DatasetError, UsageError
from depthcli.training.data import Batches, PairStore, TrainingBatch, _stored_size, whole_images
from depthcli.training.provenance import train_val_split

CPU = torch.device("cpu")
DATA = replace(PAPER.data, zoom=1.5, rotate_deg=5, gamma=0.2, brightness=0.2, noise=0.02)


def _batches(size: int = 2, seed: int = 0, **changes: object) -> Batches:
    data = replace(DATA, **changes)  # type: ignore[arg-type]
    return Batches(PairStore(rooms(), TRAIN, data), data, size, seed, CPU)


def test_depends_on_seed_and_step_alone() -> None:
    torch.manual_seed(1)
    one, other = _batches(), _batches()
    for step in (5, 0, 17, 5):
        torch.manual_seed(step)
        first = one[step]
        torch.rand(3)
        for a, b in zip(first[:2], other[step][:2], strict=True):
            assert torch.equal(a, b)
    assert not torch.equal(one[0].network_input, one[1].network_input)
    assert not torch.equal(one[0].network_input, one[one.steps_per_epoch].network_input)
    assert not torch.equal(one[0].network_input, _batches(seed=1)[0].network_input)


def test_neither_reads_nor_moves_the_global_generator() -> None:
    batches, before = _batches(), torch.get_rng_state()
    batches[3]
    assert torch.equal(torch.get_rng_state(), before)


def test_shapes_and_ranges() -> None:
    gray, depth_m, valid_mask, _ = _batches(size=3, width=48)[0]
    assert valid_mask is None
    assert gray.shape == depth_m.shape == (3, 1, 32, 48)
    assert gray.dtype == depth_m.dtype == torch.float32
    assert -1 <= float(gray.min()) < float(gray.max()) <= 1
    assert 0.5 < float(depth_m.min()) < float(depth_m.max()) < 7


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


@pytest.mark.parametrize("paired", [True, False])
def test_processes_share_the_batch_that_one_would_see(paired: bool) -> None:
    data = replace(DATA, paired=paired)
    store = PairStore(rooms(), TRAIN, data)
    alone = Batches(store, data, 4, 0, CPU)
    parts = [Batches(store, data, 4, 0, CPU, process, 2) for process in (0, 1)]
    assert [part.own_size for part in parts] == [2, 2]
    assert {part.steps_per_epoch for part in parts} == {alone.steps_per_epoch} == {1}
    for step in (0, 3):
        for i in (0, 1):
            shared = torch.cat([part[step][i] for part in parts])
            assert torch.equal(shared, alone[step][i])


def test_batch_that_cannot_be_shared_is_refused() -> None:
    store = PairStore(rooms(), TRAIN, DATA)
    with pytest.raises(UsageError):
        Batches(store, DATA, 3, 0, CPU, 0, 2)
    with pytest.raises(UsageError):
        Batches(store, DATA, 6, 0, CPU, 0, 6)
    assert Batches(store, DATA, 5, 0, CPU, 0, 5).own_size == 1
    assert Batches(store, DATA, 99 * 2, 0, CPU, 0, 2).batch_size == 4  # what both can have alike


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


def _ramps(count: int) -> Rooms:
    """Pictures that get brighter to the right, as their depth grows from 2 to 4 m."""
    share = np.broadcast_to(np.linspace(0, 1, WIDTH, dtype=np.float32), (count, HEIGHT, WIDTH))
    images = np.repeat((255 * share).astype(np.uint8)[..., None], 3, axis=3)
    return Rooms(images, 2 + 2 * share, tuple(f"den_{i}" for i in range(count)))


def _seen(paired: bool, steps: int = 4, size: int = 60, **changes: float) -> TrainingBatch:
    """Some batches of ramps in one."""
    plain = {"zoom": 1.0, "gamma": 0.0, "brightness": 0.0, "noise": 0.0, "rotate_deg": 0.0}
    data = replace(DATA, paired=paired, **(plain | changes))  # type: ignore[arg-type]
    batches = Batches(PairStore(_ramps(size), range(size), data), data, size, 0, CPU)
    seen = [batches[step] for step in range(steps)]
    return TrainingBatch(*(torch.cat(maps) for maps in zip(*(b[:2] for b in seen), strict=True)))


@pytest.mark.parametrize("paired", [True, False])
def test_flips_are_the_same_for_a_pair_and_drawn_apart_for_two_lists(paired: bool) -> None:
    seen = _seen(paired)
    mirrored = [maps[..., 0].mean((1, 2)) > maps[..., -1].mean((1, 2)) for maps in seen[:2]]
    for flips in mirrored:
        assert 0.4 < float(flips.float().mean()) < 0.6
    together = float((mirrored[0] == mirrored[1]).float().mean())
    assert together == 1 if paired else 0.4 < together < 0.6


@pytest.mark.parametrize("paired", [True, False])
def test_zooms_are_the_same_for_a_pair_and_drawn_apart_for_two_lists(paired: bool) -> None:
    """How steep a ramp is tells its zoom: of depth, 2 m over the whole, divided by the square."""
    seen = _seen(paired, zoom=2.0)
    gray, depth_m = ((maps[..., 16, 24] - maps[..., 16, 8]).abs()[:, 0] for maps in seen[:2])
    of_gray, of_depth = 1 / gray, (1 / depth_m).sqrt()
    assert 1.8 < float(of_gray.max()) < 2.1
    assert 1.8 < float(of_depth.max()) < 2.1
    correlation = float(torch.corrcoef(torch.stack([of_gray, of_depth]))[0, 1])
    assert correlation > 0.99 if paired else abs(correlation) < 0.25


def test_store_keeps_depth_to_five_millimetres() -> None:
    dataset = rooms()
    flat_m = replace(dataset, depths_m=dataset.depths_m * 0 + 9.987)  # type: ignore[type-var]
    store = PairStore(flat_m, TRAIN, DATA)
    assert store.rgb.shape == (5, 3, 64, 64)
    assert float((store.depth_m.float() - 9.987).abs().max()) < 0.005


def test_whole_pictures_are_not_augmented() -> None:
    store = PairStore(rooms(), HELD_OUT, DATA)
    (gray,) = whole_images(store, DATA, torch.tensor([0]))
    wanted = torch.nn.functional.avg_pool2d(store.rgb.float(), 2).amax(1) / 255 * 2 - 1
    torch.testing.assert_close(gray, wanted)


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
    ("picture", "stored"),
    [
        ((300, 100), (150, 300)),
        ((150, 130), (130, 260)),
        ((900, 900), (200, 400)),
        ((9, 9), (100, 200)),
    ],
)
def test_pictures_are_kept_no_larger_than_views_need(
    picture: tuple[int, int], stored: tuple[int, int]
) -> None:
    """At the network's aspect, as large as the picture along one axis, at most twice the size."""
    width, height = _stored_size((*picture, 3), replace(DATA, width=100, height=200))
    assert (width, height) == stored
