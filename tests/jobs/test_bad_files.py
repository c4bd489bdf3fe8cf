"""Each bad file ends its command in one line that says what is wrong, with its own exit code."""

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli

from depthcli.io.manifest.row import OK, Origin, Row
from robustness.bad_files import FAMILIES, MANIFESTS, write

CASES = [(family, name) for family, one in FAMILIES.items() for name in one.table]


@pytest.mark.parametrize(("family", "name"), CASES)
def test_a_bad_file_is_one_line(family: str, name: str, inside: Cli) -> None:
    file, words, table = FAMILIES[family]
    write(table[name].make, inside.folder / file)
    cv2.imwrite(str(inside.folder / "good.png"), np.full((8, 8, 3), 99, np.uint8))
    before = {path.name for path in inside.folder.iterdir()}
    done = inside(*words)
    said = done.stderr.decode()
    assert table[name].line in said
    assert done.returncode == table[name].code
    errors = [line for line in said.splitlines() if not line.startswith("depthcli: warning: ")]
    assert len(errors) == 1
    assert errors[0].startswith("depthcli: error: ")
    assert errors[0].isprintable()
    assert "unexpected " not in said
    assert {path.name for path in inside.folder.iterdir()} <= before | {"b.mkv"}  # whole frames


@pytest.mark.parametrize("name", ["manifest.jsonl", ".depthcli-batch.jsonl"])
def test_bad_rows_are_passed_over(name: str, inside: Cli) -> None:
    for folder in ("in", "out"):
        (inside.folder / folder).mkdir()
    cv2.imwrite(str(inside.folder / "in" / "a.png"), np.full((8, 8, 3), 99, np.uint8))
    for content in MANIFESTS.values():
        own = Row("other.png", OK, Origin("", "", "", "")).as_line().decode()
        (inside.folder / "out" / name).write_text(f"{own}{content}\n")
        done = inside("batch", "in", "--out", "out", "--quiet")
        assert (done.returncode, done.stderr) == (0, b"")
        assert (inside.folder / "out" / "a.depth.png").is_file()
