"""``depthcli manifest``, as a user runs it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from helpers.folders import contents, printed, tree

if TYPE_CHECKING:
    from helpers.command_line import Cli


@pytest.mark.parametrize("form", ["jsonl", "parquet"])
def test_shards_are_summed_up_listed_and_merged(inside: Cli, form: str) -> None:
    tree(inside, "a.png", "hall/b.png")
    (inside.folder / "in" / "bad\tname.png").touch()
    codes = [
        inside("batch", "in", "-o", "out", "--shard", f"{n}/2", "--manifest", form).returncode
        for n in (1, 2)
    ]
    assert sorted(codes) == [0, 1]
    said = inside("manifest", "summary", "out").stdout.decode().splitlines()
    assert said[0] == "3 inputs: 2 ok, 1 failed"
    assert said[1].startswith("2 outputs, ")
    (found,) = printed(inside("manifest", "summary", "out", "--json"))
    assert (found["inputs"], found["failed"], found["outputs"]) == (3, 1, 2)
    assert [one["inputs"] for one in found["models"]] == [3]
    assert {"model", "model_sha256", "version"} < set(found["models"][0])
    failed = inside("manifest", "failed", "out")
    assert failed.stdout.decode().count("\n") == 1
    assert "is empty" in failed.stdout.decode()
    (row,) = printed(inside("manifest", "failed", "out", "--json"))
    assert (row["input"], row["status"]) == ("bad\tname.png", "failed")
    merged = printed(inside("manifest", "merge", "out", "--format", form, "--json"))
    assert merged == [{"manifest": f"out/manifest.{form}"}]
    left = {name.split("/")[0] for name in contents(inside, "out")}
    assert left == {"a.depth.png", "hall", f"manifest.{form}"}
    assert json.loads(inside("manifest", "summary", "out", "--json").stdout) == found


def test_sums_of_rows_that_no_batch_writes_are_finite(inside: Cli) -> None:
    tree(inside, "a.png", "b.png", "c.png")
    assert inside("batch", "in", "-o", "out").returncode == 0
    manifest = inside.folder / "out" / "manifest.jsonl"
    rows = [json.loads(line) for line in manifest.read_text().splitlines()]
    for row in rows[:2]:
        row["seconds"] = 1e308
    manifest.write_text("\n".join(map(json.dumps, rows)) + "\n")
    (found,) = printed(inside("manifest", "summary", "out", "--json"))
    assert found["inputs"] == 1


def test_a_folder_without_a_manifest_is_one_line(inside: Cli) -> None:
    (inside.folder / "out").mkdir()
    for command in ("summary", "failed", "merge"):
        done = inside("manifest", command, "out")
        assert done.returncode == 2
        assert (
            done.stderr
            == b"depthcli: error: no manifest in out; name the output folder of a batch\n"
        )


def test_a_file_that_is_no_manifest_is_an_error(inside: Cli) -> None:
    (inside.folder / "notes.txt").write_text("no rows\n")
    for name in ("summary", "failed"):
        done = inside("manifest", name, "notes.txt")
        assert (done.returncode, done.stdout) == (2, b"")
        assert b"is not a manifest of depthcli" in done.stderr
    (inside.folder / "empty.jsonl").touch()
    assert inside("manifest", "summary", "empty.jsonl").returncode == 0
