"""A batch whose output folder is not left alone, or was prepared to do harm."""

import os
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers.batches import NAMES, kept, pictures, request
from helpers.tiny import write_picture

from depthcli.core.camera import CameraScale, Intrinsics
from depthcli.errors import OutputError, UsageError
from depthcli.io.images.read import read_image
from depthcli.io.listing.folder import InputFile
from depthcli.io.manifest import FAILED, OK, Journal, known_rows
from depthcli.jobs.batch.run import Batch, dry_run
from depthcli.jobs.batch.tasks import BatchOptions

JOURNAL, MANIFEST = ".depthcli-batch.jsonl", "manifest.jsonl"


@pytest.mark.parametrize("name", [JOURNAL, MANIFEST])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_pipes_and_devices_are_refused(tmp_path: Path, name: str, kind: str) -> None:
    pictures(tmp_path)
    path = tmp_path / "out" / name
    path.parent.mkdir()
    os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")
    with pytest.raises(OutputError):
        Batch(request(tmp_path))
    path.unlink()
    assert len(kept(tmp_path)) == len(NAMES)


@pytest.mark.skipif(not os.path.exists("/proc/kmsg"), reason="Linux has it")  # noqa: PTH110
def test_a_video_that_never_ends_is_refused(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.mp4").symlink_to("/proc/kmsg")
    (result,) = Batch(request(tmp_path))
    assert result.row.error == f"{tmp_path}/in/a.mp4 is empty"


def test_a_link_does_not_lead_the_journal_elsewhere(tmp_path: Path) -> None:
    pictures(tmp_path)
    precious = tmp_path / "precious.txt"
    precious.write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / JOURNAL).symlink_to(precious)
    with pytest.raises(OutputError):
        Batch(request(tmp_path))
    assert precious.read_text() == "mine"


def test_a_pipe_in_the_place_of_an_output_is_one_failure(tmp_path: Path) -> None:
    pictures(tmp_path)
    kept(tmp_path)
    path = tmp_path / "out" / "z.depth.png"
    path.unlink()
    os.mkfifo(path)
    statuses = {result.row.input: result.row.status for result in Batch(request(tmp_path))}
    assert statuses == {"a.png": OK, "hall/b.png": OK, "z.png": FAILED}


def test_of_many_batches_that_begin_at_once_one_writes(tmp_path: Path) -> None:
    """The longer the manifest, the longer each looks at it."""
    pictures(tmp_path)
    kept(tmp_path)
    manifest = tmp_path / "out" / MANIFEST
    manifest.write_bytes(manifest.read_bytes() + b'{"input": 3}\n' * 20_000)
    start, begun, refused = threading.Barrier(8), [], []

    def begin() -> None:
        start.wait()
        try:
            begun.append(Journal(tmp_path / "out"))
        except UsageError:
            refused.append(True)

    threads = [threading.Thread(target=begin) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(begun), len(refused)) == (1, 7)
    assert begun[0].row("a.png") is not None
    begun[0].finish(NAMES)
    assert known_rows(tmp_path / "out").row("a.png") is not None


def test_a_dry_run_finds_what_would_not_be_replaced(tmp_path: Path) -> None:
    pictures(tmp_path)
    write_picture(tmp_path / "out" / "a.depth.png")
    asked = request(tmp_path)
    would = {one.input: one.error for one in dry_run(asked, asked.model.load())}
    became = {result.row.input: result.row.error for result in Batch(asked)}
    assert would == became
    assert [name for name, error in would.items() if error] == ["a.png"]


def test_unreadable_folder_fails_with_its_reason(tmp_path: Path) -> None:
    pictures(tmp_path)
    asked = request(tmp_path)
    closed = InputFile("hall", f"{tmp_path}/in/hall", "in/hall cannot be listed: closed")
    asked = replace(asked, plan=replace(asked.plan, inputs=(*asked.plan.inputs, closed)))
    would = {one.input: one.error for one in dry_run(asked, asked.model.load())}
    became = {result.row.input: result.row.error for result in Batch(asked)}
    assert would == became == dict.fromkeys(NAMES) | {"hall": closed.problem}


def test_a_picture_too_large_fails_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(path: Path, *rest: Any, **options: Any) -> Any:
        if path.name == "z.png":
            raise MemoryError
        return read_image(path, *rest, **options)

    monkeypatch.setattr("depthcli.jobs.batch.workers.read_image", read)
    pictures(tmp_path)
    became = {result.row.input: result.row.error for result in Batch(request(tmp_path))}
    assert became == dict.fromkeys(NAMES) | {"z.png": "does not fit into memory; make it smaller"}


def test_options_that_fit_no_picture_end_the_batch(tmp_path: Path) -> None:
    pictures(tmp_path)
    of_another_model = CameraScale("a", "other", "0" * 64, 2.0, 0.0, None, 1, 1)
    options = BatchOptions(camera=Intrinsics(scale=of_another_model))
    with pytest.raises(UsageError):
        list(Batch(request(tmp_path, options=options)))


def test_a_file_that_disappears_after_it_was_listed_stops_no_other(tmp_path: Path) -> None:
    pictures(tmp_path)
    batch = Batch(request(tmp_path))
    (tmp_path / "in" / "z.png").unlink()
    seen = {result.row.input: result.row.error for result in batch}
    assert seen == dict.fromkeys(NAMES) | {"z.png": f"{tmp_path}/in/z.png is missing: no such file"}
