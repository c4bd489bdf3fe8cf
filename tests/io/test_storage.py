"""Temporary names: what a killed process left is used up, and no two processes share one."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import resource
import shutil
import tempfile
from typing import TYPE_CHECKING

import pytest

from depthcli.errors import OutputError, UsageError
from depthcli.io.storage import temporary as temporaries
from depthcli.io.storage.atomic import (
    append_whole,
    atomic_path,
    replace_folder,
    workspace,
    write_text,
)
from depthcli.io.storage.paths import read_regular
from depthcli.io.storage.temporary import folder_lock, open_locked, temporary_folder

if TYPE_CHECKING:
    from pathlib import Path


def test_two_at_one_output_do_not_meet(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    with atomic_path(path) as one:
        one.write_bytes(b"one")
        with atomic_path(path) as other:
            other.write_bytes(b"other")
            for name in (one.name, other.name):  # which the next run knows to be temporary
                assert re.fullmatch(r"\.depthcli-[0-9a-f]{16}\.png", name)
                assert tmp_path / name in temporaries._own
        assert path.read_bytes() == b"other"
        assert one.read_bytes() == b"one"
    assert path.read_bytes() == b"one"
    assert not {one, other} & temporaries._own
    handle = open_locked(path)
    assert handle is not None  # nobody has it any more
    os.close(handle)
    assert [found.name for found in tmp_path.iterdir()] == ["a.png"]


def test_a_lock_is_of_one_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    first = open_locked(path)
    assert first is not None
    assert open_locked(path) is None
    path.unlink()
    path.touch()  # as one who replaces the file does
    os.close(first)
    again = open_locked(path)
    assert again is not None
    os.close(again)


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


def test_a_workspace_is_empty_and_gone_afterwards(tmp_path: Path) -> None:
    root = tmp_path / "a" / "b"
    for _ in range(2):
        with workspace(root) as work:
            assert work.parent == root
            assert list(work.iterdir()) == []
            (work / "x").touch()
            with pytest.raises(UsageError):
                workspace(root).__enter__()
        assert list(root.iterdir()) == []
        (work / "of a killed process").mkdir(parents=True)
    shutil.rmtree(work)
    for error in (KeyError(), OSError(5, "broken")):
        with pytest.raises((KeyError, OutputError)), workspace(root):
            raise error
        assert list(root.iterdir()) == []


def test_a_folder_s_files_take_others_places_and_the_one_that_counts_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, target, moved = tmp_path / "made", tmp_path / "target", []
    for folder, names in ((made, "abc"), (target, "bcd")):
        folder.mkdir()
        for name in names:
            (folder / name).write_text(folder.name)
    real = os.replace
    monkeypatch.setattr(os, "replace", lambda a, b: (moved.append(a.name), real(a, b)))
    replace_folder(made, target, last="b")
    assert sorted(moved) == ["a", "b", "c"]
    assert moved[-1] == "b"
    assert {path.name: path.read_text() for path in target.iterdir()} == dict.fromkeys(
        "abc", "made"
    )
    assert {path.name: path.read_text() for path in made.iterdir()} == {"d": "target"}
    replace_folder(target, tmp_path / "other", last="b")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["made", "other"]


def test_a_folder_is_shared_or_had_alone(tmp_path: Path) -> None:
    with folder_lock(tmp_path, shared=True) as first, folder_lock(tmp_path, shared=True) as second:
        assert (first, second) == (True, True)
        with folder_lock(tmp_path) as alone:
            assert not alone
    with folder_lock(tmp_path) as alone:
        assert alone
        for shared in (True, False):
            with folder_lock(tmp_path, shared=shared) as other:
                assert not other


def test_a_new_locked_file_has_the_rights_of_any_other(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        handle = open_locked(tmp_path / "rows")
    finally:
        os.umask(before)
    assert handle is not None
    os.close(handle)
    assert (tmp_path / "rows").stat().st_mode & 0o777 == 0o666


def test_where_there_are_no_locks_all_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(_handle: int, _how: int) -> None:
        raise OSError(errno.ENOTSUP, "no locks")

    monkeypatch.setattr(fcntl, "flock", refused)
    with folder_lock(tmp_path) as one, folder_lock(tmp_path) as other:
        assert (one, other) == (True, True)

    def closed(_path: Path, _flags: int) -> int:
        raise PermissionError

    monkeypatch.setattr(os, "open", closed)  # as Windows has it for folders
    with folder_lock(tmp_path) as free:
        assert free


def test_a_file_in_no_folder_is_not_locked(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        open_locked(tmp_path / "none" / "rows")


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
