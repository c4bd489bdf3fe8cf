"""Paired differences of rows, and how sure they are: scenes vote, not pictures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from depthcli.evaluation.evaluate import differences_from, scene_interval
from depthcli.evaluation.report import ImageScores, Interval, ReportRow, Source
from depthcli.metrics.choices import Alignment
from depthcli.metrics.depth import METRICS, Scores

SCENES = tuple(f"den_{i % 12}" for i in range(60))


def _looped(values: list[float], scenes: list[str], draws: int = 4000) -> tuple[float, float]:
    """2.5th and 97.5th percentile of the mean over scenes drawn with replacement."""
    rng, names = np.random.default_rng(4), sorted(set(scenes))
    of_scene = {n: [v for v, s in zip(values, scenes, strict=True) if s == n] for n in names}
    means = []
    for _ in range(draws):
        drawn = [v for n in rng.choice(names, len(names)) for v in of_scene[str(n)]]
        means.append(sum(drawn) / len(drawn))
    means.sort()
    return means[round(0.025 * draws)], means[round(0.975 * draws)]


def test_interval_is_that_of_a_plain_loop() -> None:
    rng = np.random.default_rng(3)
    by_scene = dict(zip(sorted(set(SCENES)), rng.normal(0.1, 0.2, 12), strict=True))
    scenes = [*SCENES, *["den_3"] * 20]  # scenes of different sizes
    values = np.array([by_scene[s] for s in scenes]) + rng.normal(0, 0.05, len(scenes))
    interval = scene_interval(values, scenes)
    low, high = _looped(values.tolist(), scenes)
    assert interval.mean == pytest.approx(values.mean())
    assert interval.low == pytest.approx(low, abs=0.01)
    assert interval.high == pytest.approx(high, abs=0.01)


def test_every_digit_follows_from_the_scores() -> None:
    """10,000 draws of as many scenes as there are, by the generator that begins with 0."""
    values, scenes = np.random.default_rng(8).normal(size=12), list("aabccdefghij")
    names = sorted(set(scenes))
    counts = np.random.default_rng(0).multinomial(10, [1 / 10] * 10, 10_000)
    sums = {s: values[[name == s for name in scenes]].sum() for s in names}
    means = [
        sum(k * sums[s] for k, s in zip(draw, names, strict=True))
        / sum(k * scenes.count(s) for k, s in zip(draw, names, strict=True))
        for draw in counts.tolist()
    ]
    interval = scene_interval(values, scenes)
    assert (interval.low, interval.high) == pytest.approx(
        tuple(np.percentile(means, (2.5, 97.5))), rel=1e-12
    )


@pytest.mark.parametrize(
    ("low", "high", "clear"),
    [(0.1, 0.2, True), (-0.2, -0.1, True), (0.0, 0.2, False), (-0.2, 0.0, False)],
)
def test_an_end_at_zero_is_not_clear_of_it(low: float, high: float, clear: bool) -> None:
    assert Interval(0.1, low, high).is_significant is clear


def test_pictures_of_one_scene_are_no_evidence_of_their_own() -> None:
    values = np.random.default_rng(1).normal(0.1, 0.3, 12)
    once = scene_interval(values, SCENES[:12])
    often = scene_interval(np.tile(values, 5), SCENES)
    assert (often.low, often.high) == pytest.approx((once.low, once.high))
    apart = scene_interval(np.tile(values, 5), [str(i) for i in range(60)])
    assert apart.high - apart.low < 0.6 * (once.high - once.low)


@pytest.mark.parametrize(("shift", "clear"), [(0.5, True), (-0.5, True), (0.0, False)])
def test_clear_is_what_leaves_zero_outside(shift: float, clear: bool) -> None:
    values = np.linspace(-0.2, 0.2, 60)
    assert scene_interval(values + shift, SCENES).is_significant is clear


def test_pictures_without_a_score_are_left_out() -> None:
    values = np.array([0.1, math.nan, 0.3])
    assert scene_interval(values, ["a", "b", "c"]).mean == pytest.approx(0.2)
    none = scene_interval(np.full(3, math.nan), ["a", "b", "c"])
    assert math.isnan(none.mean)
    assert not none.is_significant


def _row(name: str, abs_rel: list[float], alignment: Alignment = Alignment.NONE) -> ReportRow:
    images = tuple(
        ImageScores(f"{i:04}", Scores.of(abs_rel=value)) for i, value in enumerate(abs_rel)
    )
    mean = Scores.of(abs_rel=sum(abs_rel) / len(abs_rel))
    return ReportRow(name, Source.MODEL, alignment, len(images), mean, images=images)


def test_rows_are_compared_picture_by_picture_with_seeds_averaged() -> None:
    groups = {
        "mean": [_row("mean", [0.5, 0.5, 0.5])],
        "ours": [_row("ours-seed0", [0.1, 0.4, 0.4]), _row("ours-seed1", [0.3, 0.2, 0.4])],
        "cut": [_row("cut", [0.6, 0.5, 0.3], Alignment.MEDIAN)],
    }
    scenes = {"0000": "a", "0001": "b", "0002": "c"}
    (found,) = differences_from("ours", groups, scenes)
    assert (found.name, found.other, found.alignment) == ("ours", "mean", Alignment.NONE)
    interval = found.intervals[list(METRICS).index("abs_rel")]
    assert interval.mean == pytest.approx(-0.2)
    assert interval.low == pytest.approx(-0.3)
    assert interval.high == pytest.approx(-0.1)


def test_each_alignment_is_compared_with_its_own() -> None:
    none, median = Alignment.NONE, Alignment.MEDIAN
    groups = {
        "mean": [_row("mean", [0.9, 0.9, 0.9]), _row("mean", [0.3, 0.3, 0.3], median)],
        "ours": [_row("ours", [0.2, 0.2, 0.2], median), _row("ours", [0.5, 0.5, 0.5])],
    }
    found = differences_from("ours", groups, {"0000": "a", "0001": "b", "0002": "c"})
    assert [(d.other, d.alignment) for d in found] == [("mean", median), ("mean", none)]
    first = list(METRICS).index("abs_rel")
    assert [d.intervals[first].mean for d in found] == pytest.approx([-0.1, -0.4])


def test_scenes_without_a_score_are_not_counted() -> None:
    groups = {}
    for name, value in (("mean", 0.5), ("ours", 0.4)):
        row, nothing = _row(name, [value] * 3), ImageScores("0001", Scores.of())
        groups[name] = [replace(row, images=(row.images[0], nothing, row.images[2]))]
    (found,) = differences_from("ours", groups, {"0000": "a", "0001": "b", "0002": "c"})
    assert found.scene_count == 2
