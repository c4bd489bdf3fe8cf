"""Scores by true distance, by kind of scene, and of the worst images, against plain loops."""

import json
from dataclasses import replace
from itertools import pairwise

import pytest
from helpers.small_set import HEIGHT, WIDTH, Playback, noisy, small_set

from depthcli.core.options import Alignment, Part
from depthcli.evaluation.evaluate import EvalOptions, evaluate
from depthcli.evaluation.page import html_page, report_page
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.evaluation.report import EvalReport
from depthcli.evaluation.task import plan_pairs

OPTIONS = EvalOptions(
    EvalProtocol(full_size_px=(WIDTH, HEIGHT)), trivial=False, per_image=True, parts=tuple(Part)
)
DATASET = small_set(12)
ROWS = [Playback(noisy(DATASET, seed=seed), name=name) for seed, name in enumerate("ab")]


@pytest.fixture(scope="module")
def report() -> EvalReport:
    return evaluate(plan_pairs(DATASET, "own"), ROWS, OPTIONS)


def _errors(row: Playback, near_m: float, far_m: float) -> list[float]:
    """Relative errors of all pixels whose true depth is in a range."""
    found = []
    for name, depth_m in zip(DATASET.ids, DATASET.depths_m, strict=True):
        pairs = zip(depth_m.ravel().tolist(), row.maps[name].ravel().tolist(), strict=True)
        for g, p in pairs:
            if max(near_m, 1e-3) <= g < far_m:
                found.append(abs(min(max(p, 1e-3), 10.0) - g) / g)
    return found


def test_distance_is_over_the_pixels_of_each_range(report: EvalReport) -> None:
    scored = report.breakdowns[0].scored
    edges = [0.001, 1, 2, 3, 5, 10]
    names = [f"{near:g}-{far:g} m" for near, far in pairwise(edges)]
    assert [one.part for one in scored] == [name for name in names for _ in "ab"]
    for i, one in enumerate(scored):
        errors = _errors(ROWS["ab".index(one.row)], edges[i // 2], edges[i // 2 + 1])
        assert one.count == len(errors)
        if errors:
            assert one.scores["abs_rel"] == pytest.approx(sum(errors) / len(errors), rel=1e-6)


def test_scene_kinds_are_means_of_their_images(report: EvalReport) -> None:
    named = {
        one.id: scene.rstrip("0123456789").rstrip("_")
        for one, scene in zip(report.rows[0].images, DATASET.scenes, strict=True)
    }
    for one in report.breakdowns[1].scored:
        row = report.rows["ab".index(one.row)]
        own = [image.scores["rmse"] for image in row.images if named[image.id] == one.part]
        assert (one.count, one.scores["rmse"]) == (len(own), pytest.approx(sum(own) / len(own)))
    assert {one.part for one in report.breakdowns[1].scored} == set(named.values())


def test_worst_images_come_first(report: EvalReport) -> None:
    own = [one for one in report.breakdowns[2].scored if one.row == "a"]
    images = sorted(report.rows[0].images, key=lambda one: -one.scores["abs_rel"])
    assert [one.part for one in own] == [image.id for image in images[:10]]


def test_text_html_and_json_have_each_part(report: EvalReport) -> None:
    page = report_page(report)
    for text in (page.to_text(), html_page(page)):
        assert all(f"error by {what}" in text for what in ("distance", "scene kind", "image"))
    document = json.loads(report.to_json())["breakdowns"]
    assert list(document) == ["distance", "scene", "image"]
    assert document["distance"][0]["count"] == report.breakdowns[0].scored[0].count


def test_aligned_rows_are_told_apart() -> None:
    both = replace(OPTIONS, alignments=(Alignment.NONE, Alignment.MEDIAN), parts=(Part.DISTANCE,))
    found = evaluate(plan_pairs(DATASET, "own"), ROWS[:1], both)
    assert {one.row for one in found.breakdowns[0].scored} == {"a", "a, median"}
