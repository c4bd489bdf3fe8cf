"""Reports as JSON, read again and compared."""

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.small_set import HEIGHT, WIDTH, Playback, noisy, small_set

from depthcli.cli.app import main
from depthcli.errors import UsageError
from depthcli.evaluation.evaluate import EvalOptions, evaluate
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.evaluation.saved import compare_reports, read_report
from depthcli.evaluation.task import plan_pairs

OPTIONS = EvalOptions(EvalProtocol(full_size_px=(WIDTH, HEIGHT)), trivial=False, per_image=True)
DATASET = small_set(12)
TASK = plan_pairs(DATASET, "own")
A, B = (Playback(noisy(DATASET, seed=seed), name=name) for seed, name in enumerate("ab"))


def _kept(folder: Path, row: Playback, limit: int | None = None, **options: bool) -> Path:
    path = folder / f"{row.name}.json"
    report = evaluate(TASK.subsampled(limit), [row], replace(OPTIONS, **options))
    path.write_text(report.to_json())
    return path


def test_report_is_read_as_it_was_written(tmp_path: Path) -> None:
    report, read = evaluate(TASK, [A], OPTIONS), read_report(_kept(tmp_path, A))
    assert (read.title, read.protocol, read.scenes) == (report.title, OPTIONS.protocol, TASK.scenes)
    assert read.rows[0].images == report.rows[0].images
    assert read.rows[0].scores == report.rows[0].scores


def test_differences_are_those_of_one_evaluation(tmp_path: Path) -> None:
    together = evaluate(TASK, [A, B], replace(OPTIONS, against="a"))
    found = compare_reports(_kept(tmp_path, A), _kept(tmp_path, B))
    assert [row.scores for row in found.rows] == [row.scores for row in together.rows]
    (one,), (other,) = found.differences, together.differences
    assert (one.name, one.other) == ("a (a)", "b (b)")
    assert (one.intervals, one.scene_count) == (other.intervals, other.scene_count)


def test_rows_are_of_the_images_that_both_have(tmp_path: Path) -> None:
    found = compare_reports(_kept(tmp_path, A, 5), _kept(tmp_path, B))
    fewer = evaluate(TASK.subsampled(5), [A, B], replace(OPTIONS, against="a"))
    assert found.image_count == 5
    for row, wanted in zip(found.rows, fewer.rows, strict=True):
        assert row.scores.values == pytest.approx(wanted.scores.values)
    means = [interval.mean for interval in found.differences[0].intervals]
    assert means == pytest.approx([i.mean for i in fewer.differences[0].intervals])


def test_without_scores_of_images_there_is_no_interval(tmp_path: Path) -> None:
    found = compare_reports(_kept(tmp_path, A, per_image=False), _kept(tmp_path, B))
    assert not found.differences
    assert len(found.rows) == 2


def test_other_protocols_and_files_are_refused(tmp_path: Path) -> None:
    a, b = _kept(tmp_path, A), tmp_path / "b.json"
    far = replace(OPTIONS, protocol=replace(OPTIONS.protocol, max_m=5.0))
    b.write_text(evaluate(TASK, [B], far).to_json())
    for content in (None, "{}", "[1", '{"protocol": 1}'):
        if content is not None:
            b.write_text(content)
        with pytest.raises(UsageError):
            compare_reports(a, b)


def test_command_writes_the_comparison(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(_kept(tmp_path, row)) for row in (A, B)]
    page = tmp_path / "page.html"
    assert main(["eval", "compare", *files, "--html", str(page)]) == 0
    text = capsys.readouterr().out
    assert "a (a) minus each row" in text
    assert "a (a) minus each row" in page.read_text()
