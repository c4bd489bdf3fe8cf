"""The table of trained runs, of runs that only a record tells of and models of one grey each."""

import csv
import io
import json
import statistics
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.small_set import HEIGHT, WIDTH, small_set
from helpers.tiny import write_model

from depthcli.core.options import Alignment
from depthcli.datasets.base import Split, SplitName
from depthcli.errors import DatasetError, UsageError
from depthcli.evaluation.evaluate import EvalOptions, entry_for, evaluate, score
from depthcli.evaluation.page import report_page
from depthcli.evaluation.predictors import ModelPredictor, open_model
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.evaluation.report import PUBLISHED, EvalReport, ReportRow
from depthcli.evaluation.task import EvalTask, group_by_seed, plan_runs
from depthcli.inference.loading import SessionLoader
from depthcli.metrics.depth import METRICS
from depthcli.training.provenance import TrainedRun

PROTOCOL = EvalProtocol(full_size_px=(WIDTH, HEIGHT))
NONE, MEDIAN = Alignment.NONE, Alignment.MEDIAN
RUN = TrainedRun(
    folder=Path("x"),
    seed=0,
    settings="{}",
    paired=False,
    parameters=1_234_567,
    epochs=4,
    epochs_planned=4,
    steps=80,
    minutes=1.23456,
    train_ids=("0002", "0003", "0004"),
    held_out_ids=("0005", "0001"),
    nyu_ids=("0002", "0003", "0004"),
)
LONGER = replace(RUN, seed=1, epochs=3, steps=60, minutes=2.5)


def _run(name: str, run: TrainedRun = RUN, **changes: object) -> TrainedRun:
    return replace(run, folder=Path(name), **changes)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> list[ModelPredictor]:
    """In no order; each says one depth of every picture, give or take the picture's grey."""
    runs = {
        "zeta": (_run("zeta"), 1.0),
        "proposed-seed1": (_run("proposed-seed1", LONGER, paired=True), 2.0),
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
        assert row.alignment is not None
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
    whole = [model for model in models if model.run.epochs == 4]
    assert _report(task, whole, published=False).notes == notes[:2]
    paper = replace(task, split=replace(task.split, name=SplitName.PAPER, train_count=1000))
    assert _report(paper, whole).notes == (
        *notes[:2],
        "the mean rows were computed from 3 of the split's 1000 training pairs",
    )


@pytest.mark.parametrize(
    ("split", "limit", "title"),
    [
        (SplitName.VAL, None, "NYU Depth v2 · scenes that the runs held out, 2 images"),
        (SplitName.OFFICIAL, 1, "NYU Depth v2 · official, 1 of 654 images"),
    ],
)
def test_titles(
    models: list[ModelPredictor], split: SplitName, limit: int | None, title: str
) -> None:
    runs = [replace(model.run, train_ids=("0003",), nyu_ids=("0003",)) for model in models]
    report = _report(plan_runs(small_set(), runs, split, limit), models)
    assert report.title == f"{title} · protocol: {PROTOCOL.name}"


def test_ids_of_custom_pairs_do_not_count_as_nyu() -> None:
    own = _run("a", train_ids=("0000", "0002"), nyu_ids=())
    assert plan_runs(small_set(), [own], SplitName.OFFICIAL).ids[:2] == ("0000", "0002")


def test_runs_are_compared_on_nyu_only() -> None:
    own = _run("a", held_out_ids=("1449",), train_ids=("1450",))
    with pytest.raises(DatasetError):
        plan_runs(small_set(2, first=1449), [own])


@pytest.mark.parametrize(
    "runs",
    [
        [_run("a"), _run("b", held_out_ids=("0001",))],
        [_run("a"), _run("b", train_ids=("0002",))],
        [_run("a", held_out_ids=())],
        [_run("a", held_out_ids=("0001", "0099"))],
        [_run("a", train_ids=("0098", "0099"))],
        [_run("a", nyu_ids=("0001", "0005"))],
    ],
    ids=["held out", "trained on", "none held out", "lost test", "lost training", "seen"],
)
def test_runs_with_different_or_missing_pairs_are_refused(runs: Sequence[TrainedRun]) -> None:
    with pytest.raises((UsageError, DatasetError)):
        plan_runs(small_set(), runs)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (_run("a-seed0"), _run("a-seed1", LONGER, settings='{"x": 1}')),
        (_run("a-seed0"), _run("a")),
    ],
)
def test_a_group_differs_in_its_seeds_alone(first: TrainedRun, second: TrainedRun) -> None:
    with pytest.raises(UsageError):
        group_by_seed([first, second])
    seeds = _run("a-seed1", LONGER)
    assert group_by_seed([first, seeds, _run("b2")]) == {"a": (first, seeds), "b2": (_run("b2"),)}
