"""Batches with bad inputs, links, odd lists, and a budget of failures."""

import errno
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers.batches import NAMES, images, kept, of_plan, outputs, request
from helpers.command_line import Cli
from helpers.requests import predict_request
from helpers.tiny import synthetic_image, write_image
from helpers.videos import flat_frames, write_video

from depthcli.core.camera import CameraScale, Intrinsics
from depthcli.errors import OutputError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format
from depthcli.io.images.read import read_image
from depthcli.io.listing import InputFile
from depthcli.io.manifest import OK, WHOLE, Journal, Shard, known_rows, parse_row, read_rows
from depthcli.jobs.batch.plan import BatchPlan, plan_files, plan_folder
from depthcli.jobs.batch.run import Batch, dry_run
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.jobs.predict import predict

JOURNAL, MANIFEST = ".depthcli-batch.jsonl", "manifest.jsonl"


def test_a_link_does_not_lead_the_journal_elsewhere(tmp_path: Path) -> None:
    images(tmp_path)
    precious = tmp_path / "precious.txt"
    precious.write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / JOURNAL).symlink_to(precious)
    with pytest.raises(OutputError):
        Batch(request(tmp_path))
    assert precious.read_text() == "mine"


def test_of_many_batches_that_begin_at_once_one_writes(tmp_path: Path) -> None:
    """The longer the manifest, the longer each looks at it."""
    images(tmp_path)
    kept(tmp_path)
    manifest = tmp_path / "out" / MANIFEST
    manifest.write_bytes(manifest.read_bytes() + b'{"input": 3}\n' * 20_000)
    start = threading.Barrier(8)

    def begin(_: int) -> Journal | None:
        start.wait()
        with suppress(UsageError):
            return Journal(tmp_path / "out")
        return None

    with ThreadPoolExecutor(8) as pool:
        (begun,) = (journal for journal in pool.map(begin, range(8)) if journal is not None)
    assert begun.row("a.png") is not None
    begun.finish(NAMES)
    assert known_rows(tmp_path / "out").row("a.png") is not None


def test_a_dry_run_finds_what_would_not_be_replaced(tmp_path: Path) -> None:
    images(tmp_path)
    write_image(tmp_path / "out" / "a.depth.png")
    job = request(tmp_path)
    would = {name: error for _, name, _, error in dry_run(job, job.model.load())}
    became = {result.row.input: result.row.error for result in Batch(job)}
    assert would == became
    assert [name for name, error in would.items() if error] == ["a.png"]


def test_unreadable_folder_fails_with_its_reason(tmp_path: Path) -> None:
    images(tmp_path)
    job = request(tmp_path)
    closed = InputFile("hall", f"{tmp_path}/in/hall", "in/hall cannot be listed: closed")
    job = replace(job, plan=replace(job.plan, inputs=(*job.plan.inputs, closed)))
    would = {name: error for _, name, _, error in dry_run(job, job.model.load())}
    became = {result.row.input: result.row.error for result in Batch(job)}
    assert would == became == dict.fromkeys(NAMES) | {"hall": closed.problem}


def test_a_folder_of_another_user_is_an_error_of_the_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mounts of containers often are; chmod does not stop root, as whom tests may run."""

    def closed(path: str) -> Any:
        raise PermissionError(errno.EACCES, "Permission denied", path)

    images(tmp_path)
    monkeypatch.setattr(os, "scandir", closed)
    with pytest.raises(UsageError, match="Permission denied"):
        plan_folder(str(tmp_path / "in"), str(tmp_path / "out"))


def test_an_image_too_large_fails_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(path: Path, *rest: Any, **options: Any) -> Any:
        if path.name == "z.png":
            raise MemoryError
        return read_image(path, *rest, **options)

    monkeypatch.setattr("depthcli.io.images.read.read_image", read)
    images(tmp_path)
    became = {result.row.input: result.row.error for result in Batch(request(tmp_path))}
    assert became == dict.fromkeys(NAMES) | {"z.png": "does not fit into memory; make it smaller"}


def test_options_that_fit_no_image_end_the_batch(tmp_path: Path) -> None:
    images(tmp_path)
    of_another_model = CameraScale("a", "other", "0" * 64, 2.0, 0.0, None, 1, 1)
    options = BatchOptions(camera=Intrinsics(scale=of_another_model))
    with pytest.raises(UsageError):
        list(Batch(request(tmp_path, options=options)))


def test_a_file_that_disappears_after_it_was_listed_stops_no_other(tmp_path: Path) -> None:
    images(tmp_path)
    batch = Batch(request(tmp_path))
    (tmp_path / "in" / "z.png").unlink()
    ends = {result.row.input: result.row.error for result in batch}
    assert ends == dict.fromkeys(NAMES) | {"z.png": f"{tmp_path}/in/z.png is missing: no such file"}


GOOD, BAD, LATE = ("a", "b"), 100, ("x", "y", "z")
AHEAD = 64  # inputs that a worker can be ahead of what is told


def half_good(folder: Path) -> None:
    """Good images before and after a stretch of empty files."""
    for number, name in enumerate((*GOOD, *LATE)):
        write_image(folder / "in" / f"{name}.png", synthetic_image(24, 32 + number))
    for number in range(BAD):
        (folder / "in" / f"m{number:03}.png").touch()


def ended(folder: Path, budget: int | None) -> Batch:
    """A batch by one worker, at its end."""
    batch = Batch(replace(request(folder), workers=1, max_failures=budget))
    for _ in batch:
        pass
    return batch


def test_the_first_failure_beyond_the_budget_stops(tmp_path: Path) -> None:
    half_good(tmp_path)
    batch = ended(tmp_path, 3)
    names = [name for name, _ in batch.tally.failures][:4]
    assert names == ["m000.png", "m001.png", "m002.png", "m003.png"]
    assert batch.stopped
    lines = (tmp_path / "out" / "manifest.jsonl").read_bytes().splitlines()
    rows = [row for row in map(parse_row, lines) if row]
    assert len(rows) == batch.tally.completed <= 2 + 4 + AHEAD
    done = {row.input for row in rows if row.status == OK}
    assert {"a.png", "b.png"} <= done  # and what a worker was at
    again = ended(tmp_path, 3)
    assert again.tally.kept >= len(done)
    assert again.stopped == batch.stopped
    for path in (tmp_path / "in").glob("m*"):
        path.unlink()
    last = ended(tmp_path, 3)
    assert last.tally.kept >= len(done)
    assert (last.tally.completed, last.tally.failures, last.stopped) == (5, [], None)


def test_nothing_is_stopped_by_the_last_input(tmp_path: Path) -> None:
    for name in GOOD:
        write_image(tmp_path / "in" / f"{name}.png")
    (tmp_path / "in" / "c.png").touch()
    batch = ended(tmp_path, 0)
    assert (batch.stopped, batch.tally.completed, len(batch.tally.failures)) == (None, 3, 1)


def test_the_command_says_why_it_stopped(inside: Cli) -> None:
    half_good(inside.folder)
    done = inside("batch", "in", "--out", "out", "--max-failures", "0", "--workers", "1", code=1)
    assert b"more than 0" in done.stderr
    assert b" of 105 inputs done" in done.stdout
    again = inside("batch", "in", "--out", "out", "--max-failures", "100", "--quiet")
    assert (again.returncode, b"stopped" in again.stderr) == (1, False)


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """Two images, of which one lies where the other's depth goes."""
    folder = tmp_path / "in" / "hall"
    image = write_image(folder / "a.png", synthetic_image(24, 32))
    return image, write_image(folder / "a.depth.png", synthetic_image(24, 33))


def test_predict_replaces_no_input_that_links_lead_to(
    tmp_path: Path, pair: tuple[Path, Path], loader: SessionLoader
) -> None:
    folder, link = tmp_path / "out", tmp_path / "link.png"
    folder.symlink_to(pair[0].parent)
    link.symlink_to(pair[1])
    for names, out in ((pair, folder), ((pair[0], link), pair[0].parent)):
        with pytest.raises(UsageError):
            predict(predict_request(names, f"{out}/", model=loader))


def test_a_batch_into_the_folder_of_its_inputs(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    (tmp_path / "out").symlink_to(tmp_path / "in")
    for out in ("in", "out"):
        with pytest.raises(UsageError):
            plan_folder(str(pair[0].parents[1]), str(tmp_path / out))


def test_a_batch_whose_folder_leads_to_inputs(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "hall").symlink_to(pair[0].parent)
    before = pair[1].read_bytes()
    words = ["hall/a.png", "hall/a.depth.png"]
    plan = plan_files(words, "mine", str(tmp_path / "in"), str(tmp_path / "out"))
    with pytest.raises(UsageError):
        Batch(of_plan(tmp_path, plan))
    assert pair[1].read_bytes() == before


def test_a_batch_whose_input_links_to_its_outputs(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    out = tmp_path / "out"
    (out / "hall").mkdir(parents=True)
    pair[1].rename(out / "hall" / "a.depth.png")
    (tmp_path / "in" / "link.png").symlink_to(out / "hall" / "a.depth.png")
    with pytest.raises(UsageError):
        Batch(of_plan(tmp_path, plan_folder(str(tmp_path / "in"), str(out))))


def test_a_link_to_another_disk_has_the_outputs(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    pair[1].unlink()
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "hall").symlink_to(tmp_path / "disk")
    plan = plan_folder(str(tmp_path / "in"), str(tmp_path / "out"))
    assert len(list(Batch(of_plan(tmp_path, plan)))) == 1
    assert (tmp_path / "disk" / "a.depth.png").is_file()


def test_entries_of_a_list_that_are_one_are_told(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    words = ["hall/a.png", "hall/a.png", "./hall/a.png", "hall/../hall/a.png", str(pair[0])]
    plan = plan_files(words, "mine", str(tmp_path / "in"), str(tmp_path / "out"))
    assert [file.name for file in plan.inputs] == ["hall/a.png"]
    assert [(file.name, file.reason) for file in plan.skipped] == [("hall/a.png", "listed twice")]


def test_two_files_with_one_name_are_refused(tmp_path: Path) -> None:
    """One outside the folder is named by all its folders, and there may be such ones inside."""
    root, outside = tmp_path / "in", write_image(tmp_path / "a.png")
    inside = write_image(root / str(outside).lstrip("/"), synthetic_image(24, 40))
    with pytest.raises(UsageError):
        plan_files([str(outside), str(inside)], "mine", str(root), str(tmp_path / "out"))


def listed(folder: Path, *names: str, shard: Shard = WHOLE) -> BatchPlan:
    return plan_files(names, "mine", str(folder / "in"), str(folder / "out"), shard=shard)


@pytest.mark.parametrize("count", [1, 2])
def test_an_output_of_an_earlier_input_is_not_replaced(tmp_path: Path, count: int) -> None:
    """Of another list, also where another shard processed it."""
    shards = [Shard(number + 1, count) for number in range(count)]
    first, later = "hall/a.jpg", "hall/a.png"
    for name, width in ((first, 32), (later, 40)):
        write_image(tmp_path / "in" / name, synthetic_image(24, width))
    before = {}
    for name, error in ((first, None), (later, str(tmp_path / "in" / first)), (first, None)):
        requests = [of_plan(tmp_path, listed(tmp_path, name, shard=s)) for s in shards]
        would = [each for asked in requests for each in dry_run(asked, asked.model.load())]
        rows = [result.row for asked in requests for result in Batch(asked)]
        assert [each[-1] for each in would] == [row.error for row in rows]
        assert error in rows[0].error if error else rows[0].error is None
        written = {n: d for n, d in outputs(tmp_path / "out").items() if n.endswith(".png")}
        assert before in ({}, written)
        before = written
    assert [row.input for row in read_rows(tmp_path / "out") if row.status == OK] == [first]
    together = [Batch(of_plan(tmp_path, listed(tmp_path, first, later, shard=s))) for s in shards]
    names = {file.path for job in together for result in job for file in result.row.outputs}
    assert names == {"hall/a.jpg.depth.png", "hall/a.png.depth.png"}


@pytest.mark.parametrize("change", ["overwrite", "gone"])
def test_an_output_of_an_earlier_input_is_replaced_on_request_or_when_that_is_gone(
    tmp_path: Path, change: str
) -> None:
    for name in ("a.mp4", "a.avi"):
        write_video(tmp_path / "in" / name, flat_frames([len(name), 99]))
    options = BatchOptions((Format.NPY,), overwrite=change == "overwrite")
    for name in ("a.mp4", "a.avi"):
        (result,) = Batch(of_plan(tmp_path, listed(tmp_path, name), options))
        assert result.row.error is None
        if change == "gone":
            (tmp_path / "in" / "a.mp4").unlink(missing_ok=True)
    assert [row.input for row in read_rows(tmp_path / "out")] == ["a.avi"]


def test_absolute_paths_have_one_name_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [write_image(tmp_path / "in" / f"{name}.png") for name in "abcdef"]
    words, names = [*map(str, paths)], list[str]()
    for number, folder in ((1, tmp_path), (2, tmp_path / "in")):
        monkeypatch.chdir(folder)
        plan = plan_files(words, "mine", None, str(tmp_path / "out"), shard=Shard(number, 2))
        names += [file.name for file in plan.inputs]
    assert sorted(names) == [word.removeprefix("/") for word in words]
    plan = plan_files(["a.png", "../in/b.png"], "mine", None, str(tmp_path / "out"))
    assert [file.name for file in plan.inputs] == ["a.png", "b.png"]
