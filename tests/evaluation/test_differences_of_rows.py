"""Paired differences of rows with intervals over scenes."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.small_set import HEIGHT, WIDTH, Playback, SmallSet, noisy, small_set

from depthcli.core.options import Alignment, Averaging
from depthcli.datasets.base import SplitName
from depthcli.errors import UsageError
from depthcli.evaluation.evaluate import (
    EvalOptions,
    check_against,
    differences_from,
    evaluate,
    scene_interval,
)
from depthcli.evaluation.page import html_page, report_page
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.evaluation.report import ImageScores, ReportRow, Source
from depthcli.evaluation.task import plan_nyu, plan_pairs
from depthcli.metrics.depth import METRICS, Scores

PROTOCOL = EvalProtocol(full_size_px=(WIDTH, HEIGHT))
NONE, MEDIAN = Alignment.NONE, Alignment.MEDIAN
ALONE = EvalOptions(PROTOCOL, trivial=False)


def _rows(dataset: SmallSet) -> list[Playback]:
    return [Playback(noisy(dataset, seed=seed), name=name) for seed, name in enumerate("abc")]


def _abs_rel(dataset: SmallSet, row: Playback, i: int) -> float:
    """Pixel by pixel; NaN without a valid one."""
    truth, depth = dataset.depths_m[i].ravel(), row.maps[dataset.ids[i]].ravel()
    pairs = [(float(g), min(max(float(p), 1e-3), 10.0)) for g, p in zip(truth, depth, strict=True)]
    errors = [abs(g - p) / g for g, p in pairs if 1e-3 < g < 10]
    return sum(errors) / len(errors) if errors else math.nan


def test_means_and_intervals_are_those_of_the_images() -> None:
    dataset = small_set(12)
    dataset.depths_m[7] = 0
    task, rows = plan_pairs(dataset, "own"), _rows(dataset)
    report = evaluate(task, rows, replace(ALONE, against="b"))
    assert not any(row.images for row in report.rows)
    assert [(d.name, d.other, d.alignment) for d in report.differences] == [
        ("b", "a", NONE),
        ("b", "c", NONE),
    ]
    kept = evaluate(task, rows, replace(replace(ALONE, per_image=True), against="b"))
    assert kept.differences == report.differences
    images = {row.name: [image.scores for image in row.images] for row in kept.rows}
    for difference in report.differences:
        other = rows["abc".index(difference.other)]
        errors = [
            _abs_rel(dataset, rows[1], i) - _abs_rel(dataset, other, i) for i in range(12) if i != 7
        ]
        found = dict(zip(METRICS, difference.intervals, strict=True))
        assert found["abs_rel"].mean == pytest.approx(sum(errors) / 11, abs=1e-6)
        for metric, interval in found.items():
            pairs = zip(images["b"], images[other.name], strict=True)
            values = np.array([one[metric] - two[metric] for one, two in pairs])
            expected = scene_interval(values, dataset.scenes)
            assert interval == expected
            assert expected.low < expected.high


def test_text_json_and_page() -> None:
    dataset = small_set(12)
    rows = [Playback(row.maps, name=f"{row.name}\n<1>") for row in _rows(dataset)]
    report = evaluate(plan_pairs(dataset, "own"), rows, replace(ALONE, against="a\n<1>"))
    entries = json.loads(report.to_json())["differences"]
    page = report_page(report)
    ((title, (header, *lines)),) = page.sections
    assert title == (
        f"a\\n<1> minus each row: mean and 95 % interval over {len(set(dataset.scenes))} scenes; "
        "! excludes 0; of so few, the intervals are too narrow"
    )
    assert header == ["minus", "align", "", *METRICS]
    assert f"\n\n{title}\n\nminus " in page.to_text()
    html = html_page(page)
    assert "a\\n&lt;1&gt; minus each row" in html
    assert len(lines) == 3 * len(entries)
    for name, entry, difference, i in zip("bc", entries, report.differences, (0, 3), strict=True):
        mean, low, high = lines[i : i + 3]
        assert (entry["row"], entry["minus"]) == ("a\n<1>", f"{name}\n<1>")
        assert entry["align"] == "none"
        assert list(entry["intervals"]) == list(METRICS)
        assert mean[:3] == [f"{name}\\n<1>", "none", "mean"]
        assert (low[:3], high[:3]) == (["", "", "low"], ["", "", "high"])
        for j, (interval, values) in enumerate(
            zip(difference.intervals, entry["intervals"].values(), strict=True), 3
        ):
            expected = {"mean": interval.mean, "low": interval.low, "high": interval.high}
            assert values == expected
            mark = "!" if interval.low > 0 or interval.high < 0 else " "
            assert mean[j] == f"{interval.mean:+.4f}{mark}"
            assert low[j] == f"{interval.low:+.4f} "
            assert high[j] == f"{interval.high:+.4f} "
            assert f"<td>{mean[j]}</td>" in html
    plain = evaluate(plan_pairs(dataset, "own"), rows, ALONE)
    assert not report_page(plain).sections
    assert "differences" not in json.loads(plain.to_json())


def test_trivial_rows_are_compared_with_their_alignments() -> None:
    dataset = small_set(20, first=985)
    task = plan_nyu(dataset, SplitName.PAPER)
    options = EvalOptions(PROTOCOL, alignments=(MEDIAN,))
    report = evaluate(task, _rows(dataset)[:1], replace(options, against="per-pixel mean"))
    assert [(d.other, d.alignment) for d in report.differences] == [
        ("constant mean", NONE),
        ("constant mean", MEDIAN),
        ("a", MEDIAN),
    ]


def test_images_of_unknown_scene_are_scenes_of_their_own() -> None:
    dataset = small_set(6)
    dataset.scenes = ("", "", "0000", "0001", "0001", "")
    scenes = plan_pairs(dataset, "own").scenes
    assert list(scenes) == list(dataset.ids)
    assert len(set(scenes.values())) == 5
    assert scenes["0003"] == scenes["0004"]
    report = evaluate(plan_pairs(dataset, "own"), _rows(dataset), replace(ALONE, against="a"))
    dataset.scenes = ("a", "b", "d", "e", "e", "c")
    named = evaluate(plan_pairs(dataset, "own"), _rows(dataset), replace(ALONE, against="a"))
    assert report.differences == named.differences


def test_one_scene_has_no_interval() -> None:
    dataset = small_set(6)
    dataset.scenes = ("room",) * 6
    report = evaluate(plan_pairs(dataset, "own"), _rows(dataset), replace(ALONE, against="a"))
    interval = report.differences[0].intervals[0]
    assert math.isfinite(interval.mean)
    assert not interval.is_significant
    page = report_page(report)
    ((title, (_, *lines)),) = page.sections
    assert title == "a minus each row: mean; 1 scene: no interval"
    column = [cells[3] for cells in lines[:3]]
    assert column == [f"{interval.mean:+.4f} ", "- ", "- "]
    (entry, _) = json.loads(report.to_json())["differences"]
    assert entry["intervals"]["abs_rel"] == {"mean": interval.mean, "low": None, "high": None}


@pytest.mark.parametrize(
    ("name", "rows", "averaging"),
    [
        ("x", "ab", Averaging.IMAGE),
        ("a", "a", Averaging.IMAGE),
        ("a", "ab", Averaging.POOLED),
    ],
)
def test_rows_that_cannot_be_compared(name: str, rows: str, averaging: Averaging) -> None:
    with pytest.raises(UsageError) as raised:
        check_against(name, list(rows), EvalProtocol(averaging=averaging))
    assert raised.value.message.option == "against"


SCENES = tuple(f"den_{i % 12}" for i in range(60))


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


def test_more_images_of_one_scene_narrow_no_interval() -> None:
    values = np.random.default_rng(1).normal(0.1, 0.3, 12)
    once = scene_interval(values, SCENES[:12])
    often = scene_interval(np.tile(values, 5), SCENES)
    assert (often.low, often.high) == pytest.approx((once.low, once.high))
    apart = scene_interval(np.tile(values, 5), [str(i) for i in range(60)])
    assert apart.high - apart.low < 0.6 * (once.high - once.low)


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


def test_scenes_without_a_score_are_not_counted() -> None:
    groups = {}
    for name, value in (("mean", 0.5), ("ours", 0.4)):
        row, nothing = _row(name, [value] * 3), ImageScores("0001", Scores.of())
        groups[name] = [replace(row, images=(row.images[0], nothing, row.images[2]))]
    (found,) = differences_from("ours", groups, {"0000": "a", "0001": "b", "0002": "c"})
    assert found.scene_count == 2
