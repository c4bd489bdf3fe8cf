"""A decoder that crashes its process costs one file of a batch, not the batch."""

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.batches import request
from helpers.command_line import ROOT, Cli
from helpers.videos import flat_frames, write_video

from depthcli.errors import InputError
from depthcli.io.formats.table import Format
from depthcli.io.listing.folder import InputFile
from depthcli.io.manifest.journal import Journal
from depthcli.io.manifest.row import OK, Origin, Row
from depthcli.jobs.batch.run import Batch
from depthcli.jobs.batch.tasks import Task, check_picture, check_video, mark_suspects

_CRASHING = """
import os
import cv2
decode = cv2.imdecode
def imdecode(data, flags):
    if b"a decoder's own error" in data.tobytes():
        os.abort()
    return decode(data, flags)
cv2.imdecode = imdecode
"""
"""Loaded by every process of the test: decoding the one file is a real crash."""


@pytest.fixture
def crashing(tmp_path: Path, inside: Cli) -> Cli:
    """The command line, of processes whose decoder crashes at one picture."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(_CRASHING)
    pictures = inside.folder / "in"
    pictures.mkdir()
    for name in "abcdef":
        cv2.imwrite(str(pictures / f"{name}.png"), np.full((8, 8, 3), ord(name), np.uint8))
    bad = pictures / "c.png"
    bad.write_bytes(bad.read_bytes() + b"a decoder's own error")
    return Cli(ROOT, inside.folder, inside.models)


def _batch(cli: Cli) -> Any:
    path = f"{cli.folder.parent / 'site'}:{ROOT}"
    return cli("batch", "in", "--out", "out", "--workers", "2", "--quiet", PYTHONPATH=path)


def _statuses(cli: Cli) -> dict[str, str]:
    lines = (cli.folder / "out" / "manifest.jsonl").read_text().splitlines()
    return {row["input"]: row["error"] or row["status"] for row in map(json.loads, lines)}


def test_a_crash_costs_one_file(crashing: Cli) -> None:
    assert _batch(crashing).returncode == -6
    assert not (crashing.folder / "out" / "manifest.jsonl").exists()
    for _ in range(2):  # found out, and known from then on
        done = _batch(crashing)
        assert done.returncode == 1
        assert b"in/c.png ends the process that decodes it (SIGABRT); save it again" in done.stderr
        found = _statuses(crashing)
        assert found.pop("c.png").startswith("in/c.png ends the process")
        assert found == dict.fromkeys(("a.png", "b.png", "d.png", "e.png", "f.png"), "ok")


def test_suspects_are_decoded_in_a_process_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    video = write_video(tmp_path / "a.avi", flat_frames([9, 99]))
    picture = cv2.imencode(".png", np.full((8, 8, 3), 9, np.uint8))[1].tobytes()
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{ROOT}")
    check_video("a.avi", video)
    check_picture("a.png", picture)
    (tmp_path / "sitecustomize.py").write_text(
        "import av, cv2, os\nav.open = cv2.imdecode = lambda *a, **b: os.abort()"
    )
    with pytest.raises(InputError, match=r"a\.avi ends the process that decodes it \(SIGABRT\)"):
        check_video("a.avi", video)
    with pytest.raises(InputError, match=r"a\.png ends the process that decodes it \(SIGABRT\)"):
        check_picture("a.png", picture)


def test_what_only_cannot_be_decoded_is_no_crash(capfd: pytest.CaptureFixture[str]) -> None:
    check_picture("a.png", b"no picture")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("killed", "cores", "options", "suspects"),
    [
        (False, 1, {"workers": 2}, ""),
        (True, 1, {"workers": 2}, "acm"),  # and of videos, done one by one, the first
        (True, 3, {"workers": 2}, "acdm"),
        (True, 1, {"workers": 2, "batch_size": 2}, "acdem"),
    ],
)
def test_what_was_under_way_when_a_batch_died_is_suspected(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    *,
    killed: bool,
    cores: int,
    options: dict[str, int],
    suspects: str,
) -> None:
    (tmp_path / "in").mkdir()
    for name in ("a.png", "b.png", "c.png", "d.png", "e.png", "f.png", "m.mp4", "n.mp4"):
        (tmp_path / "in" / name).touch()
    journal = Journal(tmp_path / "out")
    journal.add(Row("b.png", OK, Origin("0" * 64, "tiny", "1" * 64, "1.0")))
    journal._opened.close() if killed else journal.finish(None)
    asked: list[Any] = []

    class Asking:
        def run(self, _spec: object, chunks: Any, videos: Any, _record: object) -> Any:
            asked.extend(task for chunk in chunks for task in chunk)
            asked.extend(videos)
            yield from ()

    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    list(Batch(replace(request(tmp_path), **options), engine=Asking()))
    assert "".join(task.input.name[0] for task in asked) == "abcdefmn"
    assert "".join(task.input.name[0] for task in asked if task.is_suspect) == suspects


def test_the_first_inputs_without_a_row_are_suspects(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    journal.add(Row("b", OK, Origin("0" * 64, "tiny", "1" * 64, "1.0")))
    tasks = [Task(InputFile(n, n), {Format.PNG16: Path(n)}) for n in "abcdefg"]
    for count, names in ((0, ""), (1, "a"), (3, "acd"), (9, "acdefg")):
        found = list(mark_suspects(tasks, journal, count))
        assert [task.input for task in found] == [task.input for task in tasks]
        assert "".join(task.input.name for task in found if task.is_suspect) == names
    journal.finish(None)
