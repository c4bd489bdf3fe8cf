"""Scores of every row, trivial and published rows."""

import math
import threading
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import plain_evaluator as plain
from helpers.in_memory import InMemory
from helpers.small_set import HEIGHT, WIDTH, Playback, noisy, small_set
from helpers.tiny import write_model
from helpers.watched import Watched

from depthcli.core.types import DepthKind
from depthcli.errors import DatasetError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.lab.datasets.base import SplitName
from depthcli.lab.evaluation.evaluate import EvalOptions, entry_for, evaluate, score
from depthcli.lab.evaluation.predictors import Sample, open_model
from depthcli.lab.evaluation.protocol import EvalProtocol
from depthcli.lab.evaluation.report import PUBLISHED, Source
from depthcli.lab.evaluation.task import plan_nyu
from depthcli.lab.metrics.boundary import boundary_scores, mean_boundary_scores
from depthcli.lab.options import Alignment, Averaging

SMALL = (WIDTH, HEIGHT)
PROTOCOL = EvalProtocol(full_size_px=SMALL)


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
    (row,) = score(
        dataset,
        (1, 2, 5),
        [entry_for(predictor, (alignment,))],
        EvalProtocol(averaging=averaging, full_size_px=SMALL),
    )
    images = [
        plain.compare(dataset.depths_m[i], predictor.maps[dataset.ids[i]], how=alignment)
        for i in (1, 2, 5)
    ]
    expected = plain.average(images, pooled=averaging is Averaging.POOLED)

    for name, value in row.scores.items():
        assert value == pytest.approx(expected[name], rel=1e-6, abs=1e-6), name
    assert row.image_count == 3


def test_error_about_the_truth_names_the_pair() -> None:
    dataset = small_set()
    with pytest.raises(DatasetError, match="0003"):
        score(dataset, (3,), [], EvalProtocol())


@pytest.mark.parametrize(
    ("kind", "needed"), [(DepthKind.RELATIVE, "depth"), (DepthKind.INVERSE, "disparity")]
)
def test_relative_depth_needs_its_alignment(kind: DepthKind, needed: str) -> None:
    predictor = Playback({}, kind=kind)
    with pytest.raises(UsageError, match=needed):
        entry_for(predictor, [Alignment.NONE, Alignment.MEDIAN])
    assert entry_for(predictor, tuple(Alignment)).alignments == (Alignment(needed),)


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

    class Streamed(InMemory):
        ids = dataset.ids

        def depth_m(self, i: int) -> np.ndarray:
            return fresh(dataset.depths_m[i])

        def image(self, i: int) -> np.ndarray:
            return fresh(dataset.image(i))

    entries = [entry_for(Playback(noisy(dataset), look=True), tuple(Alignment))]
    score(Streamed(), range(30), entries, PROTOCOL, workers=workers)
    assert len(most) == 60
    assert 1 <= max(most) <= 4 * max(1, workers)


@pytest.mark.parametrize("averaging", Averaging)
def test_no_digit_depends_on_the_number_of_workers(averaging: Averaging) -> None:
    dataset = small_set(30)
    entries = [
        entry_for(Playback(noisy(dataset, seed=seed), look=True), tuple(Alignment))
        for seed in (5, 6)
    ]
    protocol = EvalProtocol(averaging=averaging, full_size_px=SMALL, boundary=True)
    alone, together = (
        score(dataset, range(30), entries, protocol, workers=workers) for workers in (0, 3)
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
        score(
            dataset,
            range(30),
            [entry_for(Playback(maps))],
            PROTOCOL,
            progress=watched,
            workers=3,
        )
    assert watched.stages == {"comparing images": (30, 7)}
    assert threading.active_count() == before


def test_scores_of_edges_are_those_of_the_map_put_together_again() -> None:
    """And their means those over the images."""
    dataset = small_set(shape=(40, 60))
    maps = noisy(dataset)
    protocol = EvalProtocol(full_size_px=(60, 40), boundary=True)
    (row,) = score(dataset, (0, 3), [entry_for(Playback(maps))], protocol)
    expected = []
    for image, i in zip(row.images, (0, 3), strict=True):
        depth_m = dataset.depths_m[i]
        valid = (depth_m > 1e-3) & (depth_m < 10)
        scores = boundary_scores(depth_m, maps[image.id].clip(1e-3, 10), valid)
        assert image.scores.items() >= scores._asdict().items()
        expected.append(scores)
    assert row.scores.items() >= mean_boundary_scores(expected)._asdict().items()
    assert not math.isnan(row.scores["edge_f1"])
    (without,) = score(
        dataset, (0,), [entry_for(Playback(maps))], replace(protocol, boundary=False)
    )
    assert "edge_f1" not in without.scores | without.images[0].scores


def test_trivial_rows_know_the_depth_that_counts() -> None:
    dataset = small_set()
    protocol = EvalProtocol(full_size_px=SMALL, min_m=2, max_m=5)
    task = plan_nyu(dataset, SplitName.OFFICIAL)
    (row, *_) = evaluate(task, [], EvalOptions(protocol)).rows
    training = np.concatenate([dataset.depths_m[i].ravel() for i in task.split.train])
    mean_m = training[(training > 2) & (training < 5)].astype(float).mean()
    errors = []
    for i in task.test:
        depth_m = dataset.depths_m[i]
        counted = depth_m[(depth_m > 2) & (depth_m < 5)]
        errors.append(np.mean(np.abs(counted - mean_m) / counted))
    assert row.scores["abs_rel"] == pytest.approx(np.mean(errors), rel=1e-5)


@pytest.mark.parametrize("own_camera", [True, False])
def test_metres_are_scaled_to_the_camera_of_each_image(tmp_path: Path, own_camera: bool) -> None:
    camera = {"hfov_deg": 60.0} if own_camera else None
    predictor = open_model(SessionLoader(write_model(tmp_path, camera=camera), "cpu", 1))
    dataset = small_set(2)
    dataset.hfov_deg, dataset.focal_px = 40.0, (25.0, None)  # only the first one's is known
    focal_px = [25.0, WIDTH / 2 / math.tan(math.radians(20))]
    learned_px = WIDTH / 2 / math.tan(math.radians(30))
    for i, actual_px in enumerate(focal_px):
        depth_m = predictor.predict(Sample(dataset, i)).values
        factor = actual_px / learned_px if own_camera else 1
        np.testing.assert_allclose(depth_m, (1 + 8 * i / 255) * factor, rtol=1e-5)


# The paper split needs pairs around number 1000; the headline protocol needs the full size.
AROUND_1000 = {"count": 8, "first": 995}


TABLE_I = """
abs_rel  rmse   rms_log log10   d1     d2     d3
 .3483  1.2226  .4096  .1164  .4401  .7248  .8793  CycleGAN
 .3450  1.1969  .4048  .1421  .4335  .7317  .8875  CUT
 .3385  1.2501  .4091  .1426  .4420  .7331  .8821  FastCUT
 .3384  1.1894  .3993  .1398  .4434  .7414  .8903  DCLGAN
 .3483  1.1881  .4080  .1427  .4380  .7300  .8855  SimDCL
 .3514  1.2163  .4105  .1437  .4328  .7244  .8812  HnegSRC
 .2727   .9712  .3363  .1164  .5296  .8154  .9331  Proposed
"""


def test_published_rows_are_the_papers() -> None:
    columns, *lines = (line.split() for line in TABLE_I.strip().splitlines())
    printed = {f"{name} (paper)": [float(n) for n in numbers] for *numbers, name in lines}
    assert {row.name: [row.scores[c] for c in columns] for row in PUBLISHED} == printed
    assert all(row.source is Source.PUBLISHED and row.image_count == 449 for row in PUBLISHED)
    assert all(math.isnan(row.scores["sq_rel"]) for row in PUBLISHED)


def test_only_the_misprint_is_footnoted() -> None:
    for row in PUBLISHED:
        ratio = row.scores["log10"] * math.log(10) / row.scores["rms_log"]
        assert bool(row.note) == (abs(ratio - 0.80) > 0.03), row.name


def test_trivial_rows_know_the_training_part_only() -> None:
    dataset = small_set(**AROUND_1000)
    task = plan_nyu(dataset, SplitName.PAPER)
    assert task.ids == ("1000", "1001", "1002")
    report = evaluate(task, [], EvalOptions(PROTOCOL))
    assert dataset.depth_reads == dict.fromkeys(range(8), 1)
    assert [(row.name, row.alignment) for row in report.rows] == [
        ("constant mean", "none"),
        ("constant mean", "median"),
        ("per-pixel mean", "none"),
        ("per-pixel mean", "median"),
    ]
    dataset.depths_m[5:] *= 0.5
    changed = evaluate(task, [], EvalOptions(PROTOCOL))
    assert report.rows[0].scores != changed.rows[0].scores
    assert any(
        "computed from 5 of the split's 1000 training pairs" in note for note in report.notes
    )


def test_test_part_alone_has_no_trivial_rows_and_says_so() -> None:
    task = plan_nyu(small_set(3, first=1000), SplitName.PAPER)
    report = evaluate(task, [], EvalOptions(PROTOCOL))
    assert report.rows == ()
    assert any("baselines are omitted" in note for note in report.notes)


def test_published_rows_stand_beside_the_headline_of_the_paper_split_only() -> None:
    dataset = small_set(**AROUND_1000, shape=(480, 640))
    paper, official = (
        plan_nyu(dataset, name, limit=1) for name in (SplitName.PAPER, SplitName.OFFICIAL)
    )
    pooled = EvalProtocol(averaging=Averaging.POOLED)
    assert evaluate(paper, [], EvalOptions(trivial=False)).rows == PUBLISHED
    assert evaluate(official, [], EvalOptions(trivial=False)).rows == ()
    other = evaluate(paper, [], EvalOptions(pooled, trivial=False))
    assert other.rows == ()
    assert any("the paper's rows" in note for note in other.notes)


def test_limit_is_spread_over_the_split() -> None:
    dataset = small_set(100, first=1000)
    assert plan_nyu(dataset, SplitName.PAPER, limit=3).ids == ("1000", "1050", "1099")
    assert plan_nyu(dataset, SplitName.PAPER, limit=1).ids == ("1000",)
    assert len(plan_nyu(dataset, SplitName.PAPER, limit=1000).ids) == 100
