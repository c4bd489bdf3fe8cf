from __future__ import annotations

import math
import threading
import weakref

import numpy as np
import plain_evaluator as plain
import pytest
from small_set import HEIGHT, WIDTH, Playback, Watched, noisy, small_set

from depthcli.core.types import DepthKind
from depthcli.errors import DatasetError, UsageError
from depthcli.evaluation.choices import Mask
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.evaluation.run import Entry, entry_for, evaluate
from depthcli.metrics.choices import Alignment, Averaging

SMALL = (WIDTH, HEIGHT)


class _Tracked(np.ndarray):
    """An array that can be found while it lives."""

    __hash__ = object.__hash__
    __eq__ = object.__eq__


@pytest.mark.parametrize("shape", [(HEIGHT, WIDTH), (5, 7)])
@pytest.mark.parametrize("averaging", Averaging)
@pytest.mark.parametrize("alignment", Alignment)
def test_evaluator_equals_the_plain_loop(
    alignment: Alignment, averaging: Averaging, shape: tuple[int, int]
) -> None:
    dataset = small_set()
    predictor = Playback(noisy(dataset, shape=shape))
    (row,) = evaluate(
        dataset,
        (1, 2, 5),
        [Entry(predictor, (alignment,))],
        EvalProtocol(averaging=averaging, full_size_px=SMALL),
    )
    images = [
        plain.compare(
            dataset.depths_m[i].tolist(), predictor.maps[dataset.ids[i]].tolist(), how=alignment
        )
        for i in (1, 2, 5)
    ]
    expected = plain.average(images, pooled=averaging is Averaging.POOLED)

    for name, value in row.scores.items():
        assert value == pytest.approx(expected[name], rel=1e-6, abs=1e-6), name
    assert row.image_count == 3


def test_every_entry_and_alignment_has_its_own_row() -> None:
    dataset = small_set()
    entries = [
        Entry(Playback(noisy(dataset), name="a"), (Alignment.NONE, Alignment.MEDIAN)),
        Entry(Playback(noisy(dataset, seed=6), name="b"), (Alignment.DEPTH,)),
    ]
    together = evaluate(dataset, range(6), entries, EvalProtocol(full_size_px=SMALL))
    assert [(row.name, row.alignment) for row in together] == [
        ("a", "none"),
        ("a", "median"),
        ("b", "depth"),
    ]
    alone = evaluate(dataset, range(6), entries[1:], EvalProtocol(full_size_px=SMALL))
    assert together[2] == alone[0]


def test_depth_is_read_once_and_pictures_only_if_somebody_looks() -> None:
    dataset = small_set()
    blind = [Entry(Playback(noisy(dataset)), tuple(Alignment)) for _ in range(3)]
    evaluate(dataset, range(6), blind, EvalProtocol(full_size_px=SMALL))
    assert dataset.depth_reads == dict.fromkeys(range(6), 1)
    assert dataset.image_reads == {}
    seeing = [Entry(Playback(noisy(dataset), look=True)) for _ in range(3)]
    evaluate(dataset, range(6), seeing, EvalProtocol(full_size_px=SMALL))
    assert dataset.image_reads == dict.fromkeys(range(6), 1)


def test_scores_of_each_image_on_request() -> None:
    dataset = small_set()
    entry = Entry(Playback(noisy(dataset)))
    (row,) = evaluate(dataset, (4, 0), [entry], EvalProtocol(full_size_px=SMALL), per_image=True)
    assert [image.id for image in row.images] == ["0004", "0000"]
    average = sum(image.scores["rmse"] for image in row.images) / 2
    assert row.scores["rmse"] == pytest.approx(average, rel=1e-12)
    (silent,) = evaluate(dataset, (4, 0), [entry], EvalProtocol(full_size_px=SMALL))
    assert silent.images == ()


def test_image_without_valid_pixel_is_reported() -> None:
    dataset = small_set()
    dataset.depths_m[2] = 0
    (row,) = evaluate(
        dataset, range(6), [Entry(Playback(noisy(dataset)))], EvalProtocol(full_size_px=SMALL)
    )
    assert (row.image_count, row.empty_count) == (5, 1)
    assert not math.isnan(row.scores["abs_rel"])


def test_progress_is_told_after_each_image() -> None:
    dataset = small_set()
    watched = Watched()
    evaluate(
        dataset,
        range(4),
        [Entry(Playback(noisy(dataset)))],
        EvalProtocol(full_size_px=SMALL),
        progress=watched,
    )
    assert watched.stages == {"comparing images": [4, 4]}


def test_error_about_the_truth_names_the_pair() -> None:
    dataset = small_set()
    with pytest.raises(DatasetError, match="0003: the depth is 16×12 but the protocol is about"):
        evaluate(dataset, (3,), [], EvalProtocol())


def test_raw_mask_of_a_set_without_raw_depth() -> None:
    dataset = small_set()

    class Filled:
        ids, depth_m = dataset.ids, dataset.depth_m

    with pytest.raises(DatasetError, match="the raw-valid mask needs raw depth"):
        evaluate(Filled(), (0,), [], EvalProtocol(mask=Mask.RAW, full_size_px=SMALL))


@pytest.mark.parametrize(
    ("kind", "needed"), [(DepthKind.RELATIVE, "depth"), (DepthKind.INVERSE, "disparity")]
)
def test_relative_depth_needs_its_alignment(kind: DepthKind, needed: str) -> None:
    predictor = Playback({}, kind=kind)
    with pytest.raises(UsageError, match=f"playback gives {kind} depth.* add --align {needed}"):
        entry_for(predictor, [Alignment.NONE, Alignment.MEDIAN])
    assert entry_for(predictor, tuple(Alignment)).alignments == (Alignment(needed),)


def test_inverse_depth_is_aligned_in_disparity() -> None:
    dataset = small_set()
    inverse = {
        name: (3 / depth.clip(0.1) + 1).astype(np.float32)
        for name, depth in zip(dataset.ids, dataset.depths_m, strict=True)
    }
    entry = entry_for(Playback(inverse, kind=DepthKind.INVERSE), [Alignment.DISPARITY])
    (row,) = evaluate(dataset, range(6), [entry], EvalProtocol(full_size_px=SMALL))
    assert row.scores["abs_rel"] < 1e-5


@pytest.mark.parametrize("workers", [0, 2])
def test_no_image_is_kept_in_memory(workers: int) -> None:
    dataset = small_set(30)
    alive: weakref.WeakSet[np.ndarray] = weakref.WeakSet()
    most: list[int] = []

    def fresh(array: np.ndarray) -> np.ndarray:
        # A view of its own memory: WeakSet needs a new object each time.
        copy = array.copy().view(_Tracked)
        alive.add(copy)
        most.append(len(alive))
        return copy

    class Streamed:
        ids = dataset.ids

        def depth_m(self, i: int) -> np.ndarray:
            return fresh(dataset.depths_m[i])

        def image(self, i: int) -> np.ndarray:
            return fresh(dataset.image(i))

    entries = [Entry(Playback(noisy(dataset), look=True), tuple(Alignment))]
    evaluate(Streamed(), range(30), entries, EvalProtocol(full_size_px=SMALL), workers=workers)
    assert len(most) == 60
    assert 1 <= max(most) <= 4 * max(1, workers)


@pytest.mark.parametrize("averaging", Averaging)
def test_no_digit_depends_on_the_number_of_workers(averaging: Averaging) -> None:
    dataset = small_set(30)
    entries = [
        Entry(Playback(noisy(dataset, seed=seed), look=True), tuple(Alignment)) for seed in (5, 6)
    ]
    protocol = EvalProtocol(averaging=averaging, full_size_px=SMALL, boundary=True)
    alone, together = (
        evaluate(dataset, range(30), entries, protocol, per_image=True, workers=workers)
        for workers in (0, 3)
    )
    assert repr(alone) == repr(together)  # NaN is not itself
    assert [image.id for image in together[0].images] == list(dataset.ids)


def test_an_error_ends_all_workers() -> None:
    dataset = small_set(30)
    maps = noisy(dataset)
    del maps["0007"]
    watched = Watched()
    before = threading.active_count()
    with pytest.raises(KeyError, match="0007"):
        evaluate(
            dataset,
            range(30),
            [Entry(Playback(maps))],
            EvalProtocol(full_size_px=SMALL),
            progress=watched,
            workers=3,
        )
    assert watched.stages == {"comparing images": [30, 7]}
    assert threading.active_count() == before
