"""Which files depthcli recognizes as its own before it replaces them."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

import numpy as np
import pytest

from depthcli.core.types import DepthMap, Provenance
from depthcli.errors import OutputError
from depthcli.io.formats.ply import PlyWriter
from depthcli.io.formats.sidecar import SidecarWriter
from depthcli.io.listing import own_outputs
from depthcli.io.listing.own_outputs import check_replaceable

if TYPE_CHECKING:
    from pathlib import Path

DEPTH = DepthMap(np.ones((4, 5), np.float32), provenance=Provenance(focal_px=9.0))


def test_point_clouds_of_every_version_are_own_and_scans_are_not(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    PlyWriter().write(DEPTH, path)
    check_replaceable(path)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(line for line in lines if not line.startswith(b"comment")))
    check_replaceable(path)  # as before version 0.14.0
    path.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n")
    with pytest.raises(OutputError, match="was not written by depthcli"):
        check_replaceable(path)


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
    def refuse(path: Path, _limit: int, *, first: int) -> bytes:
        raise PermissionError(errno.EACCES, f"Permission denied after {first}", str(path))

    monkeypatch.setattr(own_outputs, "read_regular", refuse)  # root may read everything
    check_replaceable(tmp_path / "a.png")  # in a folder that may not be searched
    (tmp_path / "a.png").touch()
    with pytest.raises(OutputError, match="may not be read"):
        check_replaceable(tmp_path / "a.png")
