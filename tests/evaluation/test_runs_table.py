"""The table of training runs, and what differs between its rows."""

import csv
import io
import json
import math
import statistics
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.small_set import HEIGHT, WIDTH, Playback, SmallSet, noisy, small_set
from helpers.tiny import write_model

from depthcli.core.options import Alignment, Averaging
from depthcli.datasets.base import HELD_OUT, NYU, Split, SplitName
from depthcli.errors import DatasetError, UsageError
from depthcli.evaluation.evaluate import (
    EvalOptions,
    check_against,
    differences_from,
    entry_for,
    evaluate,
    scene_interval,
    score,
)
from depthcli.evaluation.page import html_page, report_page
from depthcli.evaluation.predictors import ModelPredictor, open_model
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.evaluation.report import PUBLISHED, EvalReport, ImageScores, ReportRow, Source
from depthcli.evaluation.task import EvalTask, group_by_seed, plan_nyu, plan_pairs, plan_runs
from depthcli.inference.loading import SessionLoader
from depthcli.metrics.depth import METRICS, Scores
from depthcli.training.config import DataConfig, OptimConfig, TrainConfig
from depthcli.training.provenance import DataProvenance, TrainedRun, TrainState

PROTOCOL = EvalProtocol(full_size_px=(WIDTH, HEIGHT))
NONE, MEDIAN = Alignment.NONE, Alignment.MEDIAN
RUN = TrainedRun(
    Path("x"),
    TrainConfig(optim=OptimConfig(epochs_constant=4, epochs_decay=0)),
    TrainState(step=80, epoch=4, seconds=60 * 1.23456),
    DataProvenance(train_ids=("0002", "0003", "0004"), held_out_ids=("0005", "0001")),
    parameters=1_234_567,
)


def _run(
    name: str, run: TrainedRun = RUN, seed: int = 0, *, paired: bool = False, **data: object
) -> TrainedRun:
    config = replace(run.config, seed=seed, data=DataConfig(paired=paired))
    provenance = replace(run.provenance, **data)
    return replace(run, folder=Path(name), config=config, provenance=provenance)


LONGER = _run("x", replace(RUN, state=TrainState(step=60, epoch=3, seconds=150)), 1)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> list[ModelPredictor]:
    """In no order; each says one depth of every picture, give or take the picture's grey."""
    runs = {
        "zeta": (_run("zeta"), 1.0),
        "proposed-seed1": (_run("proposed-seed1", LONGER, 1, paired=True), 2.0),
        "proposed-seed0": (_run("proposed-seed0", paired=True), 4.0),
        "cut-seed3": (_run("cut-seed3", seed=3), 3.0),
    }
    folder, found = tmp_path_factory.mktemp("models"), []
    for i, (name, (run, far_m)) in enumerate(runs.items()):
        loader = SessionLoader(write_model(folder / name, output__shift=far_m + 4), "cpu", 1)
        predictor = replace(open_model(loader), name=name)
        found.append(replace(predictor, run=run, latency_ms=10.0 + i / 3))
    return found


@pytest.fixture
def task(models: list[ModelPredictor]) -> EvalTask:
    return plan_runs(small_set(), [model.run for model in models])


def _report(
    task: EvalTask, models: list[ModelPredictor], *alignments: Alignment, **more: object
) -> EvalReport:
    return evaluate(task, models, EvalOptions(PROTOCOL, alignments or (NONE,), **more))


def _scores(task: EvalTask, model: ModelPredictor, alignment: Alignment) -> tuple[float, ...]:
    entry = entry_for(model, (alignment,))
    return score(task.dataset, task.test, [entry], PROTOCOL)[0].scores.values


def _trained(report: EvalReport) -> list[ReportRow]:
    return [line for line in report.rows if line.training]


def test_pictures_are_those_that_the_runs_held_out(task: EvalTask) -> None:
    assert task.ids == ("0005", "0001")
    assert task.split == Split(SplitName.VAL, (2, 3, 4), (5, 1), 3, 2)


def test_rows_are_means_of_seeds_in_paper_order(
    task: EvalTask, models: list[ModelPredictor]
) -> None:
    report = _report(task, models, NONE, MEDIAN)
    zeta, proposed_1, proposed_0, cut = models
    members = {"cut": (cut,), "proposed": (proposed_1, proposed_0), "zeta": (zeta,)}
    others = [(line.name, line.alignment) for line in report.rows if not line.training]
    trivial = [(name, a) for name in ("constant mean", "per-pixel mean") for a in (NONE, MEDIAN)]
    assert others == [*trivial, *((row.name, None) for row in PUBLISHED)]
    assert [(line.name, line.alignment) for line in _trained(report)] == [
        (name, a) for name in members for a in (NONE, MEDIAN)
    ]
    for line in _trained(report):
        row = line
        each = [_scores(task, model, row.alignment) for model in members[row.name]]
        assert [run.scores.values for run in line.seeds] == each
        columns = list(zip(*each, strict=True))
        assert row.scores.values == pytest.approx([statistics.mean(c) for c in columns])
        assert (row.source, row.image_count, row.empty_count) == ("model", 2, 0)
        assert {run.name for run in line.seeds} == {m.run.name for m in members[row.name]}
        assert not any(run.images for run in line.seeds)
        if len(each) == 1:
            assert line.std is None
        else:
            expected = [statistics.stdev(c) for c in columns]
            assert line.std.values == pytest.approx(expected, rel=1e-6, abs=1e-12)
            assert (max(expected) > 0.1) is (row.alignment is NONE)  # no factor is left after it


def test_every_fact_of_the_training_is_shown(task: EvalTask, models: list[ModelPredictor]) -> None:
    report = _report(task, models)
    assert (report.dataset, report.split, report.image_count) == ("NYU Depth v2", "val", 2)
    assert (report.split_count, report.train_count, report.protocol) == (2, 3, PROTOCOL)
    lines = report_page(report).to_text().splitlines()
    shown = {line.split()[0]: line.split()[1:10] for line in lines[4:] if line}
    assert lines[3].split()[2:9] == [
        "paired",
        "seeds",
        "epochs",
        "steps",
        "minutes",
        "params",
        "ms",
    ]
    assert shown["cut"] == ["none", "no", "1", "4/4", "80", "1.2", "1.23M", "11.0", "2"]
    assert shown["proposed"] == ["none", "yes", "2", "3-4/4", "60-80", "1.9", "1.23M", "10.5", "2"]
    assert shown["DCLGAN"] == ["(paper)", "-", *"-------"]
    document = json.loads(report.to_json())
    rows = {row["name"]: row for row in document["rows"]}
    assert rows["proposed"]["training"] == {
        "seeds": [1, 0],
        "paired": True,
        "parameters": 1234567,
        "latency_ms": 10.5,
        "epochs": [3, 4],
        "epochs_planned": 4,
        "steps": [60, 80],
        "minutes": [2.5, 1.2346],
    }
    assert rows["zeta"]["training"]["latency_ms"] == 10.0
    assert rows["cut"]["standard_deviation"] is None
    assert list(rows["proposed"]["standard_deviation"]) == list(METRICS)
    assert [run["name"] for run in rows["proposed"]["runs"]] == ["proposed-seed1", "proposed-seed0"]
    assert "training" not in rows["constant mean"]
    assert "differences" not in document
    records = {r["name"]: list(r.values()) for r in csv.DictReader(io.StringIO(report.to_csv()))}
    costs = ["yes", "1 0", "3 4", "4", "60 80", "2.50 1.23", "1234567", "10.500"]
    (proposed,) = (line for line in report.rows if line.name == "proposed")
    known = ["model", "none", "NYU Depth v2", "val", "2", "metric, m", str(proposed.pixel_count)]
    known += ["", PROTOCOL.name]
    numbers = [*proposed.scores.values, *proposed.std.values]
    assert records["proposed"] == ["proposed", *known, *costs, *map(repr, numbers)]
    assert records["cut"][-9:] == [""] * 9
    assert records["CUT (paper)"][:18] == [
        *("CUT (paper)", "published", "", "NYU Depth v2", "paper", "449", "-", "", ""),
        PROTOCOL.name,
        *[""] * 8,
    ]


def test_notes(task: EvalTask, models: list[ModelPredictor]) -> None:
    notes = _report(task, models).notes
    assert notes == (
        "± is the sample standard deviation over the seeds",
        (
            "ms: median of the network alone for one image, onnxruntime on cpu, "
            "measured in turns in this run"
        ),
        "stopped before their schedule's end: proposed-seed1",
        (
            "the paper's rows are of its own 449 test images, not of these: "
            "their numbers are not comparable"
        ),
    )
    whole = [model for model in models if model.run.state.epoch == 4]
    assert _report(task, whole, published=False).notes == notes[:2]
    paper = replace(task, split=replace(task.split, name=SplitName.PAPER, train_count=1000))
    assert _report(paper, whole).notes == (
        *notes[:2],
        "the mean rows were computed from 3 of the split's 1000 training pairs",
    )


def test_a_title_states_the_part_of_a_split(models: list[ModelPredictor]) -> None:
    runs = [_run("a", model.run, train_ids=("0003",)) for model in models]
    report = _report(plan_runs(small_set(), runs, SplitName.OFFICIAL, limit=1), models)
    assert report.title == f"NYU Depth v2 · official, 1 of 654 images · protocol: {PROTOCOL.name}"


def test_ids_of_custom_pairs_do_not_count_as_nyu() -> None:
    own = _run("a", data="own", train_ids=("0000", "a2"))
    assert plan_runs(small_set(), [own], SplitName.OFFICIAL).ids[:2] == ("0000", "0002")


def test_pairs_of_ones_own_must_not_have_been_trained_on() -> None:
    dataset, own = small_set(2, first=1449), "own pairs (yard)"
    run = _run("a", data=own, held_out_ids=("1449",), train_ids=("1450",))
    task = plan_runs(dataset, [run], title="yard")
    assert (task.ids, task.is_nyu, task.title) == (("1449",), False, "yard")
    assert task.split == Split(HELD_OUT, (1,), (0,), 1, 1)
    with pytest.raises(UsageError):
        plan_runs(dataset, [_run("a", run, init_ids={own: ("1449",)})], title="yard")


@pytest.mark.parametrize(
    "runs",
    [
        [_run("a"), _run("b", held_out_ids=("0001",))],
        [_run("a"), _run("b", train_ids=("0002",))],
        [_run("a", held_out_ids=())],
        [_run("a", held_out_ids=("0001", "0099"))],
        [_run("a", train_ids=("0098", "0099"))],
        [_run("a", init_ids={NYU: ("0001", "0005")})],
    ],
    ids=["held out", "trained on", "none held out", "lost test", "lost training", "seen"],
)
def test_runs_with_different_or_missing_pairs_are_refused(runs: Sequence[TrainedRun]) -> None:
    with pytest.raises((UsageError, DatasetError)):
        plan_runs(small_set(), runs)


@pytest.mark.parametrize(
    ("first", "second"),
    [(_run("a-seed0"), _run("a-seed1", LONGER, 1, init_weights="x")), (_run("a-seed0"), _run("a"))],
)
def test_a_group_differs_in_its_seeds_alone(first: TrainedRun, second: TrainedRun) -> None:
    with pytest.raises(UsageError):
        group_by_seed([first, second])
    seeds = _run("a-seed1", LONGER, 1)
    assert group_by_seed([first, seeds, _run("b2")]) == {"a": (first, seeds), "b2": (_run("b2"),)}


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
    [("x", "ab", Averaging.IMAGE), ("a", "a", Averaging.IMAGE), ("a", "ab", Averaging.POOLED)],
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
