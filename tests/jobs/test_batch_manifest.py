"""What manifests tell."""

from dataclasses import replace
from pathlib import Path

import pytest

from depthcli.errors import UsageError
from depthcli.io.manifest import (
    FAILED,
    OK,
    AnchorEntry,
    CacheKey,
    Journal,
    ManifestRow,
    OutputFile,
    Shard,
)
from depthcli.jobs.batch.manifests import (
    ModelInputs,
    Summary,
    merge_manifests,
    read_rows,
    summarize,
)

ORIGIN = CacheKey("0" * 64, "tiny", "1" * 64, "1.0")
STRANGE = "caf\udce9 \\u00e9\n.png"


def row(name: str, seconds: float = 0.5) -> ManifestRow:
    outputs = (OutputFile(f"{name}.depth.png", 12, "2" * 64),)
    done = ManifestRow(
        name, OK, ORIGIN, outputs, seconds, "3" * 64, warnings=("far",), camera="60°"
    )
    return replace(done, anchors=AnchorEntry(9, 8, 0.25, "4" * 64))


def bad(name: str) -> ManifestRow:
    return ManifestRow(name, FAILED, ORIGIN, error="is empty")


def filled(folder: Path, *rows: ManifestRow, shard: Shard | None = None) -> None:
    journal = Journal(folder, shard or Shard())
    for one in rows:
        journal.add(one)
    journal.finish([one.input for one in rows])


def test_parts_of_shards_are_summed_up_and_merged(tmp_path: Path) -> None:
    rows = [row(str(number)) for number in range(20)] + [bad("x"), bad("y")]
    for number in (1, 2, 3):
        shard = Shard(number, 3)
        held = [one for one in rows if shard.holds(one.input)]
        assert held
        filled(tmp_path, *held, shard=shard)
    (tmp_path / ".depthcli-batch-2-of-4.jsonl").write_bytes(row("0", 9.0).as_line())
    for _ in range(2):
        found = read_rows(tmp_path)
        counted = summarize(found)
        assert counted == Summary(22, 2, 20, 240, 18.5, (ModelInputs("tiny", "1" * 64, "1.0", 22),))
        assert {one.input for one in found if one.status == FAILED} == {"x", "y"}
        assert merge_manifests(tmp_path) == tmp_path / "manifest.jsonl"
        assert [path.name for path in tmp_path.iterdir()] == ["manifest.jsonl"]
    names = [one.input for one in read_rows(tmp_path)]
    assert names == sorted(one.input for one in rows)


def test_merging_refuses_a_manifest_with_a_cut_row(tmp_path: Path) -> None:
    filled(tmp_path, row("a"), row("b"), shard=Shard(1, 2))
    path = tmp_path / "manifest-1-of-2.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    with pytest.raises(UsageError, match="line 2"):
        merge_manifests(tmp_path)
    assert path.read_bytes() == whole[:-20]


def test_merging_waits_for_no_batch_at_work(tmp_path: Path) -> None:
    filled(tmp_path, row("a"))
    shard = Journal(tmp_path, Shard(1, 2))
    with pytest.raises(UsageError):
        merge_manifests(tmp_path)
    shard.finish([])


def test_rows_come_back_whatever_their_names(tmp_path: Path) -> None:
    rows = [row("b"), bad(STRANGE), row(f"hall/{STRANGE}"), row("é")]
    filled(tmp_path, *rows)
    assert list(read_rows(tmp_path)) == list(read_rows(tmp_path / "manifest.jsonl")) == rows


def test_missing_or_unreadable_manifest_is_refused(tmp_path: Path) -> None:
    for call in (read_rows, merge_manifests):
        with pytest.raises(UsageError):
            call(tmp_path)
    with pytest.raises(UsageError):
        read_rows(tmp_path / "manifest.jsonl")
