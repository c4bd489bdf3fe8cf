"""Manifests in Parquet, and what they tell."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pyarrow.parquet as pq
import pytest
from helpers.batches import NAMES, pictures, request
from helpers.tiny import synthetic_picture, write_picture

from depthcli.errors import OutputError, UsageError
from depthcli.io.manifest.files import Shard
from depthcli.io.manifest.journal import Journal, known_rows
from depthcli.io.manifest.row import (
    FAILED,
    OK,
    AnchorEntry,
    ManifestFormat,
    Origin,
    OutputFile,
    Row,
)
from depthcli.io.parquet import Table, write_table
from depthcli.jobs.batch.manifests import (
    ModelInputs,
    Summary,
    merge_manifests,
    read_rows,
    summarize,
)
from depthcli.jobs.batch.run import Batch

if TYPE_CHECKING:
    from pathlib import Path

ORIGIN = Origin("0" * 64, "tiny", "1" * 64, "1.0")
STRANGE = "caf\udce9 \\u00e9\n.png"


def row(name: str, seconds: float = 0.5) -> Row:
    outputs = (OutputFile(f"{name}.depth.png", 12, "2" * 64),)
    done = Row(name, OK, ORIGIN, outputs, seconds, "3" * 64, warnings=("far",), camera="60°")
    return replace(done, anchors=AnchorEntry(9, 8, 0.25, "4" * 64))


def bad(name: str) -> Row:
    return Row(name, FAILED, ORIGIN, error="is empty")


def filled(folder: Path, *rows: Row, shard: Shard | None = None, form: str = "parquet") -> None:
    journal = Journal(folder, shard or Shard(), ManifestFormat(form))
    for one in rows:
        journal.add(one)
    journal.finish([one.input for one in rows])


def test_a_table_of_several_files_and_groups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("_GROUP_ROWS", 10), ("_PART_GROUPS", 3), ("_BLOCK_ROWS", 4)):
        monkeypatch.setattr(f"depthcli.io.parquet.{name}", value)
    rows = [{"n": n, "t": f"{n}", "parts": [{"a": 0.5}] * (n % 3)} for n in range(77)]
    write_table(tmp_path, {"n": int, "t": str, "parts": [{"a": float}]}, iter(rows))
    files = sorted(tmp_path.iterdir())
    assert [pq.read_metadata(path).num_rows for path in files] == [30, 30, 17]
    table = Table(tmp_path)
    assert list(table.column("t")) == [row["t"] for row in rows]
    assert list(table.column("missing")) == []
    for order in (range(77), range(76, -1, -1), (3, 70, 4, 71)):
        assert [table.row(n) for n in order] == [rows[n] for n in order]


@pytest.mark.parametrize("form", ManifestFormat)
def test_rows_come_back_from_either_format(tmp_path: Path, form: ManifestFormat) -> None:
    rows = [row("b"), bad(STRANGE), row(f"hall/{STRANGE}"), row("é")]
    filled(tmp_path, *rows, form=form)
    assert [path.name for path in tmp_path.iterdir()] == [f"manifest.{form}"]
    assert list(read_rows(tmp_path)) == list(read_rows(tmp_path / f"manifest.{form}")) == rows
    again = Journal(tmp_path)  # in the same format
    again.add(row("b", seconds=2.0))
    again.finish(["b"])
    assert [path.name for path in tmp_path.iterdir()] == [f"manifest.{form}"]
    known = known_rows(tmp_path)
    assert [known.row(one.input) for one in rows] == [row("b", 2.0), None, *rows[2:]]


def test_a_manifest_changes_its_format(tmp_path: Path) -> None:
    for form in ("jsonl", "parquet", "jsonl"):
        filled(tmp_path, row("a"), row("b"), form=form)
        assert [path.name for path in tmp_path.iterdir()] == [f"manifest.{form}"]
        assert list(read_rows(tmp_path)) == [row("a"), row("b")]


def test_parts_of_shards_are_summed_up_and_merged(tmp_path: Path) -> None:
    rows = [row(str(number)) for number in range(20)] + [bad("x"), bad("y")]
    for number, form in ((1, "jsonl"), (2, "parquet"), (3, "parquet")):
        shard = Shard(number, 3)
        held = [one for one in rows if shard.holds(one.input)]
        assert held
        filled(tmp_path, *held, shard=shard, form=form)
    (tmp_path / ".depthcli-batch-2-of-4.jsonl").write_bytes(row("0", 9.0).as_line())
    for _ in range(2):
        found = read_rows(tmp_path)
        counted = summarize(found)
        assert counted == Summary(22, 2, 20, 240, 18.5, (ModelInputs("tiny", "1" * 64, "1.0", 22),))
        assert {one.input for one in found if one.status == FAILED} == {"x", "y"}
        assert merge_manifests(tmp_path, ManifestFormat.PARQUET) == tmp_path / "manifest.parquet"
        assert [path.name for path in tmp_path.iterdir()] == ["manifest.parquet"]
    names = [one.input for one in read_rows(tmp_path)]
    assert names == sorted(one.input for one in rows)
    others = pq.read_table(tmp_path / "manifest.parquet", columns=["input", "error"])
    assert others["input"].to_pylist() == names


def test_what_has_no_manifest(tmp_path: Path) -> None:
    for call in (read_rows, merge_manifests):
        with pytest.raises(UsageError, match="no manifest in"):
            call(tmp_path)
    with pytest.raises(UsageError, match=r"cannot read the manifest .*No such file"):
        read_rows(tmp_path / "manifest.jsonl")
    (tmp_path / "manifest.parquet").mkdir()
    (tmp_path / "manifest.parquet" / "part-00000.parquet").write_bytes(b"PAR1")
    with pytest.raises(UsageError, match="is not a complete Parquet file"):
        read_rows(tmp_path)


def test_merging_waits_for_no_batch_at_work(tmp_path: Path) -> None:
    filled(tmp_path, row("a"))
    shard = Journal(tmp_path, Shard(1, 2))
    with pytest.raises(UsageError, match="another batch is writing"):
        merge_manifests(tmp_path)
    shard.finish([])


def test_a_manifest_that_cannot_be_written_loses_nothing(tmp_path: Path) -> None:
    filled(tmp_path, row("a"))
    journal = Journal(tmp_path)
    journal.add(row("b"))
    journal.manifest = tmp_path / "manifest.parquet" / "part-00000.parquet" / "manifest.parquet"
    with pytest.raises(OutputError, match="cannot write"):
        journal.finish(["b"])
    journal._opened.close()
    assert list(read_rows(tmp_path)) == [row("a"), row("b")]


def test_a_batch_with_a_manifest_in_parquet_goes_on(tmp_path: Path) -> None:
    pictures(tmp_path)
    write_picture(tmp_path / "in" / "caf\udce9.png", synthetic_picture(24, 50))
    asked = replace(request(tmp_path), manifest=ManifestFormat.PARQUET)
    assert not any(result.is_kept for result in Batch(asked))
    assert not (tmp_path / "out" / "manifest.jsonl").exists()
    again = list(Batch(request(tmp_path)))
    assert len(again) == len(NAMES) + 1
    assert all(result.is_kept for result in again)
