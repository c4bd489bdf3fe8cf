"""The table of training runs, and what differs between its rows."""

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.small_set import HEIGHT, WIDTH, Playback, SmallSet, noisy, small_set
from helpers.tiny import write_model

from depthcli.errors import DatasetError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.lab.datasets.base import HELD_OUT, NYU, Split, SplitName
from depthcli.lab.evaluation.evaluate import (
    EvalOptions,
    check_against,
    differences_from,
    evaluate,
    scene_interval,
)
from depthcli.lab.evaluation.page import html_page, report_page
from depthcli.lab.evaluation.predictors import ModelPredictor, open_model
from depthcli.lab.evaluation.protocol import EvalProtocol
from depthcli.lab.evaluation.report import PUBLISHED, EvalReport, ImageScores, ReportRow, Source
from depthcli.lab.evaluation.task import EvalTask, group_by_seed, plan_pairs, plan_runs
from depthcli.lab.metrics.depth import METRICS, in_full
from depthcli.lab.options import Alignment, Averaging
from depthcli.lab.training.config import DataConfig, OptimConfig, TrainConfig
from depthcli.lab.training.provenance import DataProvenance, TrainedRun, TrainState

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
    """In no order; each says one depth of every image, give or take the image's grey."""
    runs = {
        "zeta": (_run("zeta"), 1.0),
        "proposed-seed1": (_run("proposed-seed1", LONGER, 1, paired=True), 2.0),
        "proposed-seed0": (_run("proposed-seed0", paired=True), 4.0),
        "cut-seed3": (_run("cut-seed3", seed=3), 3.0),
    }
    folder, predictors = tmp_path_factory.mktemp("models"), []
    for i, (name, (run, far_m)) in enumerate(runs.items()):
        loader = SessionLoader(write_model(folder / name, output__shift=far_m + 4), "cpu", 1)
        predictor = replace(open_model(loader), name=name)
        predictors.append(replace(predictor, run=run, latency_ms=10.0 + i / 3))
    return predictors


@pytest.fixture
def task(models: list[ModelPredictor]) -> EvalTask:
    return plan_runs(small_set(), [model.run for model in models])


def _report(
    task: EvalTask, models: list[ModelPredictor], *alignments: Alignment, **more: object
) -> EvalReport:
    return evaluate(task, models, EvalOptions(PROTOCOL, alignments or (NONE,), **more))


def test_images_are_those_that_the_runs_held_out(task: EvalTask) -> None:
    assert task.ids == ("0005", "0001")
    assert task.split == Split(SplitName.VAL, (2, 3, 4), (5, 1), 3, 2)


def test_rows_are_groups_of_seeds_in_paper_order(
    task: EvalTask, models: list[ModelPredictor]
) -> None:
    report = _report(task, models, NONE, MEDIAN)
    trained = [line for line in report.rows if line.training]
    others = [(line.name, line.alignment) for line in report.rows if not line.training]
    trivial = [(name, a) for name in ("constant mean", "per-pixel mean") for a in (NONE, MEDIAN)]
    assert others == [*trivial, *((row.name, None) for row in PUBLISHED)]
    members = {
        "cut": {"cut-seed3"},
        "proposed": {"proposed-seed0", "proposed-seed1"},
        "zeta": {"zeta"},
    }
    assert [(line.name, line.alignment) for line in trained] == [
        (name, a) for name in members for a in (NONE, MEDIAN)
    ]
    for line in trained:
        assert {run.name for run in line.seeds} == members[line.name]
        assert (line.std is None) is (len(line.seeds) == 1)
        assert not any(run.images for run in line.seeds)


def test_every_fact_of_the_training_is_shown(task: EvalTask, models: list[ModelPredictor]) -> None:
    report = _report(task, models)
    assert (report.dataset, report.split, report.image_count) == ("NYU Depth v2", "val", 2)
    assert (report.split_count, report.train_count, report.protocol) == (2, 3, PROTOCOL)
    lines = report_page(report).to_text().splitlines()
    cells = {line.split()[0]: line.split()[1:10] for line in lines[4:] if line}
    assert lines[3].split()[2:9] == [
        "paired",
        "seeds",
        "epochs",
        "steps",
        "minutes",
        "params",
        "ms",
    ]
    assert cells["cut"] == ["none", "no", "1", "4/4", "80", "1.2", "1.23M", "11.0", "2"]
    assert cells["proposed"] == ["none", "yes", "2", "3-4/4", "60-80", "1.9", "1.23M", "10.5", "2"]
    assert cells["DCLGAN"] == ["(paper)", "-", *"-------"]
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
    facts = ["model", "none", "NYU Depth v2", "val", "2", "metric, m", str(proposed.pixel_count)]
    facts += ["", PROTOCOL.name]
    numbers = [*proposed.scores.values(), *proposed.std.values()]
    assert records["proposed"] == ["proposed", *facts, *costs, *map(repr, numbers)]
    assert records["cut"][-9:] == [""] * 9
    assert records["CUT (paper)"][:18] == [
        *("CUT (paper)", "published", "", "NYU Depth v2", "paper", "449", "-", "", ""),
        PROTOCOL.name,
        *[""] * 8,
    ]


def test_notes_name_runs_that_stopped_early_and_rows_of_other_images(
    task: EvalTask, models: list[ModelPredictor]
) -> None:
    *_, stopped, published = _report(task, models).notes
    assert stopped.endswith(": proposed-seed1")
    assert "the paper's rows" in published
    whole = [model for model in models if model.run.state.epoch == 4]
    notes = _report(task, whole, published=False).notes
    assert not {stopped, published} & {*notes}
    paper = replace(task, split=replace(task.split, name=SplitName.PAPER, train_count=1000))
    *same, trained_on = _report(paper, whole).notes
    assert tuple(same) == notes
    assert "3 of the split's 1000" in trained_on


def test_ids_of_custom_pairs_do_not_count_as_nyu() -> None:
    run = _run("a", data="own", train_ids=("0000", "a2"))
    assert plan_runs(small_set(), [run], SplitName.OFFICIAL).ids[:2] == ("0000", "0002")


def test_pairs_of_ones_own_must_not_have_been_trained_on() -> None:
    dataset, data = small_set(2, first=1449), "own pairs (yard)"
    run = _run("a", data=data, held_out_ids=("1449",), train_ids=("1450",))
    task = plan_runs(dataset, [run], title="yard")
    assert (task.ids, task.is_nyu, task.title) == (("1449",), False, "yard")
    assert task.split == Split(HELD_OUT, (1,), (0,), 1, 1)
    with pytest.raises(UsageError):
        plan_runs(dataset, [_run("a", run, init_ids={data: ("1449",)})], title="yard")


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
    "other",
    [
        {"init_weights": "model.onnx 5678"},
        {"pseudo_labels": "9 pseudo labels (photos)"},
        {"pseudo_label_ids": {"own pairs (photos)": ("a1",)}},
        {"pseudo_label_fingerprint": "of the pseudo labels"},
        {"data": "own pairs (mine)"},
        {"train_ids": ("0001",)},
    ],
)
def test_a_group_differs_in_its_seeds_alone(other: dict[str, object]) -> None:
    first, second = _run("a-seed0"), _run("a-seed1", LONGER, 1)
    assert group_by_seed([first, second, _run("b2")]) == {"a": (first, second), "b2": (_run("b2"),)}
    for wrong in (_run("a-seed1", LONGER, 1, **other), _run("a")):
        with pytest.raises(UsageError):
            group_by_seed([first, wrong])


ALONE = EvalOptions(PROTOCOL, trivial=False)


def _rows(dataset: SmallSet) -> list[Playback]:
    return [Playback(noisy(dataset, seed=seed), name=name) for seed, name in enumerate("abc")]


def test_text_json_and_page() -> None:
    dataset = small_set(12)
    rows = [Playback(row.maps, name=f"{row.name}\n<1>") for row in _rows(dataset)]
    report = evaluate(plan_pairs(dataset, "own"), rows, replace(ALONE, against="a\n<1>"))
    page = report_page(report)
    ((title, (header, *lines)),) = page.sections
    assert f"over {len(set(dataset.scenes))} scenes" in title
    assert header == ["minus", "align", "", *METRICS]
    assert f"\n\n{title}\n\nminus " in page.to_text()
    html = html_page(page)
    assert "a\\n&lt;1&gt; minus each row" in html
    entries = json.loads(report.to_json())["differences"]
    for entry, difference, i in zip(entries, report.differences, (0, 3), strict=True):
        assert (entry["row"], entry["minus"]) == (difference.name, difference.other)
        for j, (metric, interval) in enumerate(
            zip(METRICS, difference.intervals, strict=True), start=3
        ):
            low, high = interval.low, interval.high
            assert entry["intervals"][metric] == {"mean": interval.mean, "low": low, "high": high}
            mark = "!" if low > 0 or high < 0 else " "
            cells = [f"{interval.mean:+.4f}{mark}", f"{low:+.4f} ", f"{high:+.4f} "]
            assert [line[j] for line in lines[i : i + 3]] == cells
            assert f"<td>{cells[0]}</td>" in html
    plain = evaluate(plan_pairs(dataset, "own"), rows, ALONE)
    assert not report_page(plain).sections
    assert "differences" not in json.loads(plain.to_json())


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


def test_images_without_a_score_are_left_out() -> None:
    values = np.array([0.1, math.nan, 0.3])
    assert scene_interval(values, ["a", "b", "c"]).mean == pytest.approx(0.2)
    none = scene_interval(np.full(3, math.nan), ["a", "b", "c"])
    assert math.isnan(none.mean)
    assert not none.is_significant


def _row(name: str, abs_rel: list[float], alignment: Alignment = Alignment.NONE) -> ReportRow:
    images = tuple(ImageScores(f"{i:04}", {"abs_rel": x}) for i, x in enumerate(abs_rel))
    mean = {"abs_rel": sum(abs_rel) / len(abs_rel)}
    return ReportRow(name, Source.MODEL, alignment, len(images), mean, images=images)


def test_rows_are_compared_image_by_image_with_seeds_averaged() -> None:
    groups = {
        "mean": [_row("mean", [0.5, 0.5, 0.5])],
        "ours": [_row("ours-seed0", [0.1, 0.4, 0.4]), _row("ours-seed1", [0.3, 0.2, 0.4])],
        "cut": [_row("cut", [0.6, 0.5, 0.3], Alignment.MEDIAN)],
    }
    scenes = {"0000": "a", "0001": "b", "0002": "c"}
    (entry,) = differences_from("ours", groups, scenes)
    assert (entry.name, entry.other, entry.alignment) == ("ours", "mean", Alignment.NONE)
    interval = entry.intervals[list(METRICS).index("abs_rel")]
    assert interval.mean == pytest.approx(-0.2)
    assert interval.low == pytest.approx(-0.3)
    assert interval.high == pytest.approx(-0.1)


def test_scenes_without_a_score_are_not_counted() -> None:
    groups = {}
    for name, value in (("mean", 0.5), ("ours", 0.4)):
        row, nothing = _row(name, [value] * 3), ImageScores("0001", in_full({}))
        groups[name] = [replace(row, images=(row.images[0], nothing, row.images[2]))]
    (entry,) = differences_from("ours", groups, {"0000": "a", "0001": "b", "0002": "c"})
    assert entry.scene_count == 2
