"""Which files depthcli recognizes as its own before it replaces them."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

import numpy as np
import pytest

from depthcli.core.types import DepthMap, Provenance
from depthcli.errors import OutputError
from depthcli.io.formats.sidecar import SidecarWriter
from depthcli.io.formats.table import Format, WriterOptions, is_own
from depthcli.io.listing import own_outputs
from depthcli.io.listing.own_outputs import check_replaceable

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


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    "text", ['{"camera": {}}', "\n[1]", '{"software": "other 1.0"}', "// camera\n{}", "9"]
)
def test_sidecars_are_own_and_other_json_is_not(tmp_path: Path, text: str, encoding: str) -> None:
    path = tmp_path / "a.json"
    SidecarWriter().write(DEPTH, path)
    check_replaceable(path)
    path.write_bytes(b"")
    check_replaceable(path)
    path.write_text(text, encoding)
    with pytest.raises(OutputError, match="was not written by depthcli"):
        check_replaceable(path)


def test_a_file_that_may_not_be_read_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> bytes:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(own_outputs, "read_head", refuse)  # root may read everything
    check_replaceable(tmp_path / "a.png")  # in a folder that may not be searched
    (tmp_path / "a.png").touch()
    with pytest.raises(OutputError, match="may not be read"):
        check_replaceable(tmp_path / "a.png")
