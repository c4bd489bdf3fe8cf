from __future__ import annotations

import csv
import io
import json
import math

import pytest
from helpers.small_set import HEIGHT, WIDTH, Playback, noisy, small_set
from helpers.watched import Watched

from depthcli.datasets.base import SplitName
from depthcli.evaluation.evaluate import EvalOptions, evaluate
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.evaluation.report import PUBLISHED, Source
from depthcli.evaluation.task import plan_nyu
from depthcli.metrics.choices import Alignment, Averaging
from depthcli.metrics.depth import METRICS

# The paper split needs pairs around number 1000; the headline protocol needs the full size.
AROUND_1000 = {"count": 8, "first": 995}
ANY_SIZE = EvalProtocol(full_size_px=(WIDTH, HEIGHT))


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
    report = evaluate(task, [], EvalOptions(ANY_SIZE))
    assert dataset.depth_reads == dict.fromkeys(range(8), 1)
    assert [(row.name, row.alignment) for row in report.rows] == [
        ("constant mean", "none"),
        ("constant mean", "median"),
        ("per-pixel mean", "none"),
        ("per-pixel mean", "median"),
    ]
    dataset.depths_m[5:] *= 0.5
    changed = evaluate(task, [], EvalOptions(ANY_SIZE))
    assert report.rows[0].scores != changed.rows[0].scores
    assert any(
        "computed from 5 of the split's 1000 training pairs" in note for note in report.notes
    )


def test_trivial_rows_get_every_alignment_that_is_asked_for() -> None:
    task = plan_nyu(small_set(**AROUND_1000), SplitName.PAPER)
    report = evaluate(task, [], EvalOptions(ANY_SIZE, alignments=(Alignment.DEPTH,)))
    alignments = [row.alignment for row in report.rows if row.name == "per-pixel mean"]
    assert alignments == ["none", "median", "depth"]


def test_trivial_rows_can_be_left_out() -> None:
    dataset = small_set(**AROUND_1000)
    report = evaluate(plan_nyu(dataset, SplitName.PAPER), [], EvalOptions(ANY_SIZE, trivial=False))
    assert report.rows == ()
    assert set(dataset.depth_reads) == {5, 6, 7}


def test_test_part_alone_has_no_trivial_rows_and_says_so() -> None:
    task = plan_nyu(small_set(3, first=1000), SplitName.PAPER)
    report = evaluate(task, [], EvalOptions(ANY_SIZE))
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


def test_title_names_split_images_and_protocol() -> None:
    task = plan_nyu(small_set(**AROUND_1000), SplitName.PAPER)
    report = evaluate(task, [], EvalOptions(ANY_SIZE))
    assert report.title == ("NYU Depth v2 · paper split, 3 of 449 images · protocol: 16×12")
    val = evaluate(plan_nyu(small_set(), SplitName.OFFICIAL), [], EvalOptions(ANY_SIZE))
    assert "official split, 3 of 654 images" in val.title


def test_json_holds_every_number_and_what_it_means() -> None:
    dataset = small_set(**AROUND_1000)
    predictor = Playback(noisy(dataset), model_sha256="ab" * 32)
    task = plan_nyu(dataset, SplitName.PAPER)
    report = evaluate(task, [predictor], EvalOptions(ANY_SIZE, per_image=True))
    document = json.loads(report.to_json())
    assert document["split"]["name"] == "paper"
    assert document["split"]["images"] == 3
    assert document["split"]["training_pairs_of_trivial_rows"] == 5
    assert document["protocol"]["averaging"] == "image"
    row = document["rows"][-1]
    assert (row["name"], row["source"], row["align"]) == ("playback", "files", "none")
    assert row["model_sha256"] == "ab" * 32
    assert row["scores"] == dict(report.rows[-1].scores.items())
    assert [image["id"] for image in row["per_image"]] == ["1000", "1001", "1002"]
    assert list(row["per_image"][0]) == ["id", *METRICS]


def test_json_of_published_rows_has_null_where_nothing_was_printed() -> None:
    dataset = small_set(**AROUND_1000, shape=(480, 640))
    report = evaluate(plan_nyu(dataset, SplitName.PAPER, limit=1), [], EvalOptions(trivial=False))
    document = json.loads(report.to_json())
    assert document["schema"] == 1
    first = document["rows"][0]
    assert first["scores"]["silog"] is None
    assert first["align"] is None
    assert "misprint" in first["note"]


def test_csv_names_protocol_and_split_in_every_line() -> None:
    dataset = small_set(**AROUND_1000, shape=(480, 640))
    task = plan_nyu(dataset, SplitName.PAPER, limit=1)
    report = evaluate(task, [Playback(noisy(dataset))], EvalOptions(trivial=False))
    lines = list(csv.DictReader(io.StringIO(report.to_csv())))
    assert len(lines) == 8
    assert {(line["split"], line["protocol"]) for line in lines} == {("paper", "headline")}
    assert lines[0]["sq_rel"] == ""
    assert lines[0]["images"] == "449"
    assert lines[-1]["images"] == "1"
    assert float(lines[-1]["rmse"]) == report.rows[-1].scores["rmse"]


def test_progress_has_two_stages() -> None:
    watched = Watched()
    task = plan_nyu(small_set(**AROUND_1000), SplitName.PAPER)
    evaluate(task, [], EvalOptions(ANY_SIZE), watched)
    assert watched.stages == {"mean of training images": (5, 5), "comparing images": (3, 3)}


@pytest.mark.parametrize("name", SplitName)
def test_every_split_can_be_planned(name: SplitName) -> None:
    assert plan_nyu(small_set(20, first=985), name).ids
