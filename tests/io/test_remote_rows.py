"""Rows and pictures of a bucket: what is fetched, sent and removed there, and what is listed."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from helpers.file_trees import contents
from helpers.stores import remote

from depthcli.errors import OutputError, UsageError
from depthcli.io.listing.folder import InputFile, Skipped, list_folder
from depthcli.io.manifest.files import RowsFolder

if TYPE_CHECKING:
    from helpers.stores import Bucket, Faults


PART = r"out/\.depthcli-batch\.jsonl\.\d{20}-[0-9a-f]{8}"
JOURNAL = ".depthcli-batch.jsonl"


@pytest.fixture
def left(bucket: Bucket) -> dict[str, bytes]:
    """What an earlier batch that was killed, and others, left in a folder."""
    parts = [f"{JOURNAL}.{number:020}-0123abcd" for number in (7, 8, 10)]
    found = {
        "manifest.jsonl": b"whole\n",
        **dict(zip(parts, (b"a\n", b"b\n", b"c\n"), strict=True)),
        "manifest-1-of-2.jsonl": b"shard\n",
    }
    for name, data in found.items():
        bucket.put(f"out/{name}", data)
    for name in (
        "out/a.png",
        "out/.depthcli-aside",
        "out/nearby",
        "manifest.jsonl",
        "out2/manifest",
        "out/manifest_old/a.depth.png",
        "out/manifests/day1/a.depth.png",
        "out/.depthcli-batch-notes.txt",
    ):
        bucket.put(name, b"not a row")
    return found


@pytest.mark.usefixtures("left")
def test_rows_are_fetched_and_parts_put_together(bucket: Bucket) -> None:
    out = remote(bucket.uri("out"))
    before = bucket.objects()
    rows = RowsFolder(out)
    assert contents(rows.path) == {
        "manifest.jsonl": b"whole\n",
        "manifest-1-of-2.jsonl": b"shard\n",
        JOURNAL: b"a\nb\nc\n",
    }
    for name in ("manifest.jsonl", "manifest-1-of-2.jsonl"):
        assert (rows.path / name).stat().st_mtime == (out / name).stat().st_mtime
    rows.sync()
    rows.finish()
    assert bucket.objects() == before
    assert not rows.path.exists()
    with pytest.raises(OutputError):
        RowsFolder(remote("s3://no-such-bucket/out"))
    assert RowsFolder(Path("here")).path == Path("here")


def test_new_rows_are_sent_now_and_then_as_parts(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1000.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    rows = RowsFolder(remote(bucket.uri("out")))
    journal = rows.path / JOURNAL
    sent: list[bytes] = []
    for passed, data, expected in [
        (4.9, b"a\n", []),
        (0.1, b"b\n", [b"a\nb\n"]),
        (4.9, b"c\n", [b"a\nb\n"]),
        (0.1, b"", [b"a\nb\n", b"c\n"]),
        (5.0, b"", [b"a\nb\n", b"c\n"]),
        (5.0, b"d\n", [b"a\nb\n", b"c\n", b"d\n"]),
    ]:
        now += passed
        with journal.open("ab") as file:
            file.write(data)
        rows.sync()
        sent = list(bucket.objects().values())
        assert sent == expected
    assert all(re.fullmatch(PART, name) for name in bucket.names())
    with journal.open("ab") as file:
        file.write(b"e\n")
    rows.finish()  # as of a batch that was stopped: its journal stays
    again = RowsFolder(remote(bucket.uri("out")))
    assert contents(again.path) == {JOURNAL: b"a\nb\nc\nd\ne\n"}
    again.finish()


@pytest.mark.usefixtures("left")
def test_the_manifest_takes_the_place_of_parts(bucket: Bucket, faults: Faults) -> None:
    out = remote(bucket.uri("out"))
    rows = RowsFolder(out)
    (rows.path / JOURNAL).unlink()
    (rows.path / "manifest-1-of-2.jsonl").unlink()
    (rows.path / "manifest.jsonl").write_bytes(b"all\n")
    faults.passed.clear()
    faults.fault = lambda method, *_: None if method in {"PUT", "GET", "HEAD"} else "403"
    with pytest.raises(OutputError):
        rows.finish()
    faults.fault = lambda *_: None
    put = sorted(place.partition("/out/")[2] for verb, place in faults.passed if verb == "PUT")
    rows.finish()
    assert put == ["manifest.jsonl"]
    found = {name: data for name, data in bucket.objects().items() if data != b"not a row"}
    assert found == {
        "out/manifest.jsonl": b"all\n",
    }


def test_folder_of_a_store_is_listed_like_a_local_one(bucket: Bucket) -> None:
    names = [
        *("a.jpg", "in/", "in/.b.jpg", "in/.c/d.jpg", "in/e.txt", "in/f.depth.mkv", "in/g.JPG"),
        *("in/h/i.mp4", "in/h/j/k.png", "in/l/m.jpg", "in/l/n/o.jpg", "in/p", "in/q.out/r.jpg"),
        *("in/out/s.jpg", "in/out.jpg", "in/l.jpg"),
    ]
    for name in names:
        bucket.put(name, b"")
    root = bucket.uri("in")
    found = list_folder(root, leave_out=f"{root}/out", skip={"l", "h/j"}.__contains__)
    wanted = ["g.JPG", "l.jpg", "out.jpg", "h/i.mp4", "q.out/r.jpg"]
    assert found.media == [InputFile(name, bucket.uri(f"in/{name}")) for name in wanted]
    assert found.skipped == [
        Skipped(".b.jpg", "hidden"),
        Skipped("e.txt", ".txt"),
        Skipped("f.depth.mkv", "written by depthcli"),
        Skipped("p", "without suffix"),
    ]
    every = list_folder(bucket.uri(), leave_out="elsewhere").media
    assert [one.name for one in every if "out/" in one.name] == ["in/out/s.jpg", "in/q.out/r.jpg"]
    assert every[0] == InputFile("a.jpg", bucket.uri("a.jpg"))


def test_empty_or_forbidden_folder_of_a_store_is_a_usage_error(
    bucket: Bucket, faults: Faults
) -> None:
    with pytest.raises(UsageError):
        list_folder(bucket.uri("in"), leave_out="out")
    faults.fault = lambda *_: "403"
    with pytest.raises(UsageError):
        list_folder(bucket.uri("in"), leave_out="out")
