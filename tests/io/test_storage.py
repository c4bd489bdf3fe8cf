"""Writing files: complete or not at all, over no foreign one; temporary and user folders."""

import errno
import fcntl
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from helpers.file_trees import names

from depthcli.core.types import DepthMap, Frame, Provenance
from depthcli.errors import OutputError
from depthcli.io import guard as guards
from depthcli.io.formats.table import Format, WriterOptions, writer_of
from depthcli.io.guard import Guard, is_own
from depthcli.io.storage import atomic as temporaries
from depthcli.io.storage.atomic import (
    append_whole,
    atomic_path,
    folder_lock,
    open_locked,
    remove_stale,
    temporary_beside,
    temporary_folder,
    write_text,
)
from depthcli.io.storage.paths import read_regular


def test_two_at_one_output_do_not_meet(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    with atomic_path(path) as first:
        first.write_bytes(b"one")
        with atomic_path(path) as other:
            other.write_bytes(b"other")
            for name in (first.name, other.name):  # which the next run knows to be temporary
                assert re.fullmatch(r"\.depthcli-[0-9a-f]{16}\.png", name)
                assert tmp_path / name in temporaries._own
        assert path.read_bytes() == b"other"
        assert first.read_bytes() == b"one"
    assert path.read_bytes() == b"one"
    assert not {first, other} & temporaries._own
    handle = open_locked(path)
    assert handle is not None  # nobody has it any more
    os.close(handle)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.png"]


def test_links_are_not_locked(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(OSError, match="links"):
        open_locked(tmp_path / "link")


def test_incomplete_append_is_undone(tmp_path: Path) -> None:
    path = tmp_path / "rows"
    path.write_bytes(b"one\n")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))  # the disk is full
    try:
        with path.open("ab", buffering=0) as file:
            assert append_whole(file, b"two\n") == 4
            with pytest.raises(OSError, match="File too large"):
                append_whole(file, b"three\n")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_bytes() == b"one\ntwo\n"


def test_where_there_are_no_locks_all_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(_handle: int, _how: int) -> None:
        raise OSError(errno.ENOTSUP, "no locks")

    monkeypatch.setattr(fcntl, "flock", refused)
    with folder_lock(tmp_path) as first, folder_lock(tmp_path) as other:
        assert (first, other) == (True, True)

    def closed(_path: Path, _flags: int) -> int:
        raise PermissionError

    monkeypatch.setattr(os, "open", closed)  # as Windows has it for folders
    with folder_lock(tmp_path) as free:
        assert free


def test_files_are_read_up_to_a_size(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_regular(path, 5) == b"12345"
    assert [read_regular(path, 5, first=n) for n in (0, 2, 9)] == [b"", b"12", b"12345"]
    with pytest.raises(OSError, match="it has more than 4 bytes"):
        read_regular(path, 4)


def test_without_a_place_for_temporary_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", "/nowhere")
    with pytest.raises(OutputError), temporary_folder():
        pass


def test_a_text_is_utf_8_whatever_the_locale(tmp_path: Path) -> None:
    path = tmp_path / "new" / "er" / "a.txt"
    write_text("é深\n", path)
    assert path.read_bytes() == "é深\n".encode()


WRITER = """
import os, sys, threading
from pathlib import Path
from depthcli.io.storage.atomic import remove_own, temporary_beside
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
        name = process.stdout.readline().strip()
        remove_stale(tmp_path)
        assert names(tmp_path) == [name]
        process.kill()
        process.wait()
        remove_stale(tmp_path)
        assert names(tmp_path) == []


def test_when_the_process_ends_its_files_go_whatever_its_threads_do(tmp_path: Path) -> None:
    with writer(tmp_path, "a.png", "b.exr", "c.npy") as process:
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


def test_without_locks_temporary_files_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("depthcli.io.storage.atomic.lock", lambda *_, **__: True)
    path = tmp_path / f".depthcli-{'a' * 16}.png"
    path.touch()
    remove_stale(tmp_path)
    assert names(tmp_path) == [path.name]


ONES = np.ones((4, 5), np.float32)
DEPTH = DepthMap(ONES, provenance=Provenance(focal_px=9.0), error=ONES / 8)


@pytest.mark.parametrize("format_", Format)
def test_files_of_every_format_are_own_by_mark_or_default_name(
    tmp_path: Path, format_: Format
) -> None:
    path = tmp_path / f"a{format_.facts.suffix}"
    writer_of(format_, WriterOptions()).write(DEPTH, path, Frame(np.zeros((4, 5, 3), np.uint8)))
    assert is_own(path)
    other = tmp_path / f"other{path.suffix}"
    other.write_bytes(b"another program's")
    assert not is_own(other)


def test_suffixes_of_no_output_format_are_never_own(tmp_path: Path) -> None:
    path = tmp_path / "a.preview.jpg"
    path.write_bytes(b"depthcli:software\0")
    assert not is_own(path)


@pytest.mark.parametrize("name", ["a.json", "a.png", "a.npy", "a.mkv", "a.mp4", "a.pfm", "a"])
def test_a_foreign_file_is_replaced_on_request_only(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    guard = Guard.of(())
    guard.check(path)  # there is none
    path.touch()
    guard.check(path)  # an empty one, such as mktemp makes
    path.write_bytes(b"another program's")
    with pytest.raises(OutputError) as refused:
        guard.check(path)
    assert "{overwrite}" in refused.value.message.advice
    Guard.of((), overwrite=True).check(path)


def test_an_input_is_never_replaced(tmp_path: Path) -> None:
    source, link, other = (tmp_path / name for name in ("a.png", "link.png", "other.png"))
    source.write_bytes(b"image")
    link.symlink_to(source)
    other.hardlink_to(source)
    guard = Guard.of([source], overwrite=True)
    for path in (source, link, other, tmp_path / "yet to be made" / ".." / "a.png"):
        with pytest.raises(OutputError):
            guard.check(path)
    with pytest.raises(OutputError):
        guard.check(tmp_path / "b.png", link)


def test_a_file_that_may_not_be_read_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> bool:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(guards, "is_own", refuse)  # root may read everything
    guard = Guard.of(())
    guard.check(tmp_path / "a.png")
    (tmp_path / "a.png").write_bytes(b"secret")
    with pytest.raises(OutputError):
        guard.check(tmp_path / "a.png")
