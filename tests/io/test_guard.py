"""Existing files are replaced only if depthcli wrote them, or on request; inputs never."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

import numpy as np
import pytest

from depthcli.core.types import DepthMap, Provenance
from depthcli.errors import OutputError
from depthcli.io.formats.sidecar import SidecarWriter
from depthcli.io.formats.table import Format, WriterOptions, is_own
from depthcli.io.storage.atomic import Guard, atomic_path

if TYPE_CHECKING:
    from pathlib import Path

DEPTH = DepthMap(np.ones((4, 5), np.float32), provenance=Provenance(focal_px=9.0))


@pytest.mark.parametrize("which", Format)
def test_files_of_every_format_are_own_by_mark_or_default_name(
    tmp_path: Path, which: Format
) -> None:
    path = tmp_path / f"a{which.facts.suffix}"
    WriterOptions().writer(which).write(DEPTH, path)
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
    guard = Guard.of(is_own, ())
    guard.check(path)  # there is none
    path.touch()
    guard.check(path)  # an empty one, such as mktemp makes
    path.write_bytes(b"another program's")
    with pytest.raises(OutputError) as refused:
        guard.check(path)
    assert "{overwrite}" in refused.value.message.advice
    Guard.of(is_own, (), overwrite=True).check(path)


def test_a_file_of_depthcli_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    SidecarWriter().write(DEPTH, path)
    Guard.of(is_own, ()).check(path)


def test_an_input_is_never_replaced(tmp_path: Path) -> None:
    source, link = tmp_path / "a.png", tmp_path / "link.png"
    source.write_bytes(b"image")
    link.symlink_to(source)
    guard = Guard.of(is_own, [source], overwrite=True)
    for path in (source, link, tmp_path / "yet to be made" / ".." / "a.png"):
        with pytest.raises(OutputError), atomic_path(path, guard=guard):
            pytest.fail("nothing is written")
    with pytest.raises(OutputError):
        guard.checked([tmp_path / "b.png"]).check(link)


def test_a_file_that_may_not_be_read_is_not_replaced(tmp_path: Path) -> None:
    def refuse(path: Path) -> bool:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    guard = Guard.of(refuse, ())  # root may read everything
    guard.check(tmp_path / "a.png")
    (tmp_path / "a.png").write_bytes(b"secret")
    with pytest.raises(OutputError):
        guard.check(tmp_path / "a.png")
