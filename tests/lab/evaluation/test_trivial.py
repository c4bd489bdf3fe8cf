"""Baselines, breakdowns, kept reports, and images that a model was trained on."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.small_set import HEIGHT, WIDTH, Playback, noisy, small_set

from depthcli.cli.app import main
from depthcli.errors import DatasetError, ExitCode, UsageError
from depthcli.lab.datasets.base import SplitName
from depthcli.lab.evaluation.evaluate import EvalOptions, evaluate
from depthcli.lab.evaluation.page import html_page, report_page
from depthcli.lab.evaluation.predictors import fit_trivial
from depthcli.lab.evaluation.protocol import EvalProtocol
from depthcli.lab.evaluation.report import EvalReport
from depthcli.lab.evaluation.saved import compare_reports
from depthcli.lab.evaluation.task import plan_nyu, plan_pairs, train_overlap, trained_numbers
from depthcli.lab.metrics.depth import METRICS, add_metric
from depthcli.lab.options import Alignment, Averaging, Part
from depthcli.models.card import ModelCard
from depthcli.models.catalog import ready_card


def test_means_are_of_valid_pixels() -> None:
    dataset = small_set()
    dataset.depths_m[:, 0, 0] = 0
    dataset.depths_m[:, 0, 1] = [0, 3, 0, 0, 5, 0]
    constant, per_pixel = fit_trivial(dataset, (0, 1, 4))
    depths_m = dataset.depths_m[[0, 1, 4]].astype(float)
    valid = np.ma.masked_outside(depths_m, 1.001e-3, 9.999)
    np.testing.assert_allclose(constant.depth.values, valid.mean(), rtol=1e-6)
    expected = valid.mean(0).filled(valid.mean())
    np.testing.assert_allclose(per_pixel.depth.values, expected, rtol=1e-6)
    assert per_pixel.depth.values[0, 1] == 4.0


def test_training_pairs_of_no_depth_or_of_different_sizes_are_refused() -> None:
    class Mixed:
        ids = ("a", "b")

        def depth_m(self, i: int) -> np.ndarray:
            return np.full((2, 2 + i), 3, np.float32)

    empty = small_set()
    empty.depths_m[...] = 0
    for dataset, numbers in ((empty, ()), (empty, (0, 1)), (Mixed(), (0, 1))):
        with pytest.raises(DatasetError):
            fit_trivial(dataset, numbers)


def card(training: dict[str, Any]) -> ModelCard:
    return replace(ready_card("fastdepth"), training=training)


@pytest.mark.parametrize(
    ("training", "expected"),
    [
        ({"nyu_train_ids": "0000-0002,0900"}, {0, 1, 2, 900}),
        ({"nyu_split": "official"}, {1, 3, 5, 7}),
        ({"nyu_split": "paper"}, set(range(8))),
        ({"nyu_train_ids": "all"}, None),
        ({"nyu_split": "eigen"}, None),
        ({}, None),
    ],
)
def test_trained_numbers_are_the_card_s(
    training: dict[str, Any], expected: set[int] | None
) -> None:
    """Scenes are pairs of neighbours; odd ones are the official training part."""
    assert trained_numbers(card(training), small_set(8)) == expected


def test_only_images_that_are_compared_count() -> None:
    task = plan_nyu(small_set(8), SplitName.OFFICIAL)  # 0, 2, 4, 6
    assert train_overlap(card({"nyu_train_ids": "0002-0004"}), task) == 2
    assert train_overlap(card({"nyu_train_ids": "0001"}), task) == 0
    assert train_overlap(card({}), task) is None
    pairs = plan_pairs(small_set(8), "own")
    assert train_overlap(card({"nyu_train_ids": "0002-0004"}), pairs) is None


@pytest.mark.parametrize("name", ["meter-nyu", "fastdepth"])
def test_ready_cards_of_nyu_name_its_official_split(name: str) -> None:
    assert trained_numbers(ready_card(name), small_set(4)) == {1, 3}


OPTIONS = EvalOptions(EvalProtocol(full_size_px=(WIDTH, HEIGHT)), trivial=False, per_image=True)
DATASET = small_set(12)
TASK = plan_pairs(DATASET, "own")
A, B = (Playback(noisy(DATASET, seed=seed), name=name) for seed, name in enumerate("ab"))


def _kept(
    folder: Path, row: Playback, limit: int | None = None, options: EvalOptions = OPTIONS
) -> Path:
    path = folder / f"{row.name}.json"
    report = evaluate(TASK.subsampled(limit), [row], options)
    path.write_text(report.to_json())
    return path


def test_differences_are_those_of_one_evaluation(tmp_path: Path) -> None:
    together = evaluate(TASK, [A, B], replace(OPTIONS, against="a"))
    table = compare_reports(_kept(tmp_path, A), _kept(tmp_path, B))
    assert [row.scores for row in table.rows] == [row.scores for row in together.rows]
    (first,), (other,) = table.differences, together.differences
    assert (first.name, first.other) == ("a (a)", "b (b)")
    assert (first.intervals, first.scene_count) == (other.intervals, other.scene_count)


def test_rows_are_of_the_images_that_both_have(tmp_path: Path) -> None:
    table = compare_reports(_kept(tmp_path, A, 5), _kept(tmp_path, B))
    fewer = evaluate(TASK.subsampled(5), [A, B], replace(OPTIONS, against="a"))
    assert table.image_count == 5
    for row, expected in zip(table.rows, fewer.rows, strict=True):
        assert row.scores == pytest.approx(expected.scores)
    means = [interval.mean for interval in table.differences[0].intervals]
    assert means == pytest.approx([i.mean for i in fewer.differences[0].intervals])


def test_a_report_is_consistent_with_a_reference_or_differs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A reader checks a figure of README on some of its images."""
    reference = _kept(tmp_path, A)
    (tmp_path / "new").mkdir()
    same, other = _kept(tmp_path / "new", A, 5), _kept(tmp_path, B)
    for new, code, verdict in (
        (same, ExitCode.OK, "is consistent with"),
        (other, ExitCode.SOME_FAILED, "differs from"),
    ):
        words = ["eval", "compare", str(new), str(reference), "--tolerance", "0.02"]
        assert main(words) == code
        assert verdict in capsys.readouterr().out
    alone = _kept(tmp_path / "new", B, None, replace(OPTIONS, per_image=False))
    assert main([*words[:2], str(alone), *words[3:]]) == ExitCode.USAGE
    assert "--per-image" in capsys.readouterr().err


def test_without_means_of_images_there_is_no_interval(tmp_path: Path) -> None:
    pooled = replace(OPTIONS.protocol, averaging=Averaging.POOLED)
    for options in (replace(OPTIONS, per_image=False), replace(OPTIONS, protocol=pooled)):
        table = compare_reports(_kept(tmp_path, A, 5, options), _kept(tmp_path, B, None, options))
        assert not table.differences
        alone = evaluate(TASK.subsampled(5), [A], options), evaluate(TASK, [B], options)
        assert [row.scores for row in table.rows] == [single.rows[0].scores for single in alone]


def test_metric_of_ones_own_is_compared_without_its_module(tmp_path: Path) -> None:
    add_metric("bias", lambda g, p: float((p - g).mean()))
    METRICS["bias"] = replace(METRICS["bias"], higher_is_better=True, unit="metres")
    try:
        files = _kept(tmp_path, A), _kept(tmp_path, B)
        intervals = evaluate(TASK, [A, B], replace(OPTIONS, against="a")).differences[0].intervals
        METRICS.pop("bias")
        assert compare_reports(*files).differences[0].intervals == intervals
        assert (METRICS["bias"].higher_is_better, METRICS["bias"].unit) == (True, "metres")
        METRICS.pop("bias")
        _kept(tmp_path, B)  # without it
        assert np.isnan(compare_reports(*files).differences[0].intervals[-1].mean)
    finally:
        METRICS.pop("bias", None)


def test_rows_that_were_trained_on_the_images_are_marked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files, page = [_kept(tmp_path, row) for row in (A, B)], tmp_path / "page.html"
    document = json.loads(files[1].read_text())
    document["rows"][0] |= {"images_trained_on": 12, "note": "b was trained on 12 of these images"}
    document["notes"] = ["known depth"]
    files[1].write_text(json.dumps(document))
    words = ["eval", "compare", *map(str, files), "--html", str(page)]
    assert main(words) == 0
    for text in (capsys.readouterr().out, page.read_text()):
        assert "a (a) minus each row" in text
        assert "b (b)*" in text
        assert "* b: b was trained on 12 of these images" in text
        assert "b: known depth" in text
    assert main([*words, "--json"]) == 0
    comparison = json.loads(capsys.readouterr().out)
    assert [row.get("images_trained_on") for row in comparison["rows"]] == [None, 12]
    assert comparison["rows"][1]["note"].endswith(document["rows"][0]["note"])
    assert comparison["notes"] == ["b: known depth"]


def test_other_protocols_and_files_are_refused(tmp_path: Path) -> None:
    a, b = _kept(tmp_path, A), tmp_path / "b.json"
    far = replace(OPTIONS, protocol=replace(OPTIONS.protocol, max_m=5.0))
    b.write_text(evaluate(TASK, [B], far).to_json())
    for content in (None, "{}", "[1", '{"protocol": 1}'):
        if content is not None:
            b.write_text(content)
        with pytest.raises(UsageError):
            compare_reports(a, b)


BY_PARTS = replace(OPTIONS, parts=tuple(Part))


@pytest.fixture(scope="module")
def report() -> EvalReport:
    return evaluate(TASK, [A, B], BY_PARTS)


def _errors(row: Playback, near_m: float, far_m: float) -> list[float]:
    """Relative errors of all pixels whose true depth is in a range."""
    errors = []
    for name, depth_m in zip(DATASET.ids, DATASET.depths_m, strict=True):
        pairs = zip(depth_m.ravel().tolist(), row.maps[name].ravel().tolist(), strict=True)
        for g, p in pairs:
            if max(near_m, 1e-3) <= g < far_m:
                errors.append(abs(min(max(p, 1e-3), 10.0) - g) / g)
    return errors


def test_distance_is_over_the_pixels_of_each_range(report: EvalReport) -> None:
    scored = report.breakdowns[0].scored
    edges = [0.001, 1, 2, 3, 5, 10]
    names = [f"{near:g}-{far:g} m" for near, far in pairwise(edges)]
    assert [entry.part for entry in scored] == [name for name in names for _ in "ab"]
    for i, entry in enumerate(scored):
        errors = _errors({"a": A, "b": B}[entry.row], edges[i // 2], edges[i // 2 + 1])
        assert entry.count == len(errors)
        if errors:
            assert entry.scores["abs_rel"] == pytest.approx(sum(errors) / len(errors), rel=1e-6)


def test_scene_kinds_are_means_of_their_images(report: EvalReport) -> None:
    named = {
        image.id: scene.rstrip("0123456789").rstrip("_")
        for image, scene in zip(report.rows[0].images, DATASET.scenes, strict=True)
    }
    for entry in report.breakdowns[1].scored:
        row = report.rows["ab".index(entry.row)]
        rmse = [image.scores["rmse"] for image in row.images if named[image.id] == entry.part]
        assert (entry.count, entry.scores["rmse"]) == (len(rmse), pytest.approx(np.mean(rmse)))
    assert {entry.part for entry in report.breakdowns[1].scored} == set(named.values())


def test_worst_images_come_first(report: EvalReport) -> None:
    worst = [entry for entry in report.breakdowns[2].scored if entry.row == "a"]
    images = sorted(report.rows[0].images, key=lambda image: -image.scores["abs_rel"])
    assert [entry.part for entry in worst] == [image.id for image in images[:10]]


def test_text_html_and_json_have_each_part(report: EvalReport) -> None:
    page = report_page(report)
    for text in (page.to_text(), html_page(page)):
        assert all(f"error by {what}" in text for what in ("distance", "scene kind", "image"))
    document = json.loads(report.to_json())["breakdowns"]
    assert list(document) == ["distance", "scene", "image"]
    assert document["distance"][0]["count"] == report.breakdowns[0].scored[0].count


def test_aligned_rows_are_told_apart() -> None:
    both = replace(BY_PARTS, alignments=(Alignment.NONE, Alignment.MEDIAN), parts=(Part.DISTANCE,))
    table = evaluate(TASK, [A], both)
    assert {entry.row for entry in table.breakdowns[0].scored} == {"a", "a, median"}
