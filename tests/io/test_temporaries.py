"""Temporary files: what a killed process left goes, what a live one writes stays."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from typing import TYPE_CHECKING

from helpers.file_trees import names

from depthcli.io.storage import temporary as temporaries
from depthcli.io.storage.temporary import remove_stale, temporary_beside

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

WRITER = """
import os, sys, threading
from pathlib import Path
from depthcli.io.storage.temporary import remove_own, temporary_beside
def write(name):
    while True:
        with temporary_beside(Path(name)) as path:
            path.write_bytes(b"whole")
            path.rename(name)
with temporary_beside(Path("kept")) as path:
    path.touch()
    print(path.name, flush=True)
    for name in sys.argv[1:]:
        threading.Thread(target=write, args=(name,), daemon=True).start()
    sys.stdin.readline()
    remove_own()
    os._exit(0)
"""


def writer(folder: Path, *names: str) -> subprocess.Popen[str]:
    """A process that has a temporary file, and writes others, until it gets a line."""
    return subprocess.Popen(
        [sys.executable, "-c", WRITER, *names],
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def test_of_a_live_process_nothing_is_removed_and_of_a_killed_one_all(tmp_path: Path) -> None:
    with writer(tmp_path) as process:
        assert process.stdout is not None
        name = process.stdout.readline().strip()
        remove_stale(tmp_path)
        assert names(tmp_path) == [name]
        process.kill()
        process.wait()
        remove_stale(tmp_path)
        assert names(tmp_path) == []


def test_when_the_process_ends_its_files_go_whatever_its_threads_do(tmp_path: Path) -> None:
    with writer(tmp_path, "a.png", "b.exr", "c.npy") as process:
        assert process.stdout is not None
        process.stdout.readline()
        while len(list(tmp_path.glob("[abc].*"))) < 3:
            time.sleep(0.001)
        process.communicate("\n")
    assert names(tmp_path) == ["a.png", "b.exr", "c.npy"]


def test_leftovers_of_killed_runs_are_removed_and_nothing_else(tmp_path: Path) -> None:
    left = tmp_path / f".depthcli-{'a' * 16}.png"
    others = [".depthcli-batch.jsonl", ".depthcli-mine", "a.depth.png"]
    for name in (left.name, *others):
        (tmp_path / name).touch()
    with temporary_beside(tmp_path / "a.png") as path:
        path.touch()
        remove_stale(tmp_path)  # our own is in use
        assert names(tmp_path) == sorted([path.name, *others])
        path.unlink()
    assert names(tmp_path) == others


def test_links_and_folders_are_nobody_s_temporary_files(tmp_path: Path) -> None:
    (tmp_path / "precious").write_bytes(b"x")
    for letter in "abcd":
        (tmp_path / f".depthcli-{letter * 16}").symlink_to("precious")
        (tmp_path / f".depthcli-{letter * 16}.d").mkdir()
        (tmp_path / f".depthcli-{letter * 16}.png").touch()  # which goes all the same
    remove_stale(tmp_path)
    assert len(names(tmp_path)) == 1 + 2 * 4
    assert not list(tmp_path.glob(".depthcli-*.png"))
    remove_stale(tmp_path / "missing")


def test_without_locks_what_was_written_to_today_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("depthcli.io.storage.temporary.lock", lambda *_, **__: True)
    old, new = (tmp_path / f".depthcli-{letter * 16}.png" for letter in "ab")
    for path in (old, new):
        path.touch()
    for path, hours in ((old, 25), (new, 23)):
        os.utime(path, (time.time() - 3600 * hours,) * 2)
    remove_stale(tmp_path)
    assert names(tmp_path) == [new.name]


def test_a_name_that_cannot_be_had_is_nobody_s(tmp_path: Path) -> None:
    with temporary_beside(tmp_path / "missing" / "a.png") as path:
        assert {own for own in temporaries._own if own.parent == path.parent} == {path}
