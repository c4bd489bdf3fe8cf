"""Batches that run again, watch a folder, and their manifests; the same bytes."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.batches import outputs
from helpers.command_line import ROOT, Cli
from helpers.folders import contents, image, printed, rows, tree
from helpers.tiny import synthetic_image, write_image, write_model
from helpers.videos import write_mp4

JOURNAL = ".depthcli-batch.jsonl"
COUNT = 40


def many(cli: Cli) -> None:
    """Images that take a while, no two alike, in two folders."""
    random = np.random.default_rng(0)
    for number in range(COUNT):
        pixels = random.integers(0, 256, (350, 350), dtype=np.uint8)
        image(cli, f"{number % 2}/{number:03}.png", pixels)


def begun(cli: Cli, done: int, *options: str) -> subprocess.Popen[bytes]:
    """A batch that has put down some rows and goes on."""
    running = cli.started("batch", "in", "--out", "out", *options)
    journal = cli.folder / "out" / JOURNAL
    until = time.monotonic() + 30
    while time.monotonic() < until and running.poll() is None:
        if journal.exists() and journal.read_bytes().count(b"\n") >= done:
            break
        time.sleep(0.002)
    return running


def kept(cli: Cli, *words: str) -> dict[str, bool]:
    """Which inputs were already done."""
    return {row["input"]: row["kept"] for row in printed(cli("batch", "in", *words, "--json"))}


def test_a_killed_batch_goes_on_and_gives_the_same_bytes(cli: Cli) -> None:
    many(cli)
    running = begun(cli, 15, "--format", "png16", "--format", "exr")
    running.kill()
    assert running.wait(timeout=30) == -signal.SIGKILL
    # What was being written when the power went.
    (cli.folder / "out" / "0" / ".depthcli-0123456789abcdef.png").write_bytes(b"half a pict")
    with (cli.folder / "out" / JOURNAL).open("ab") as journal:
        journal.write(b'{"input": "0/0')
    before = (cli.folder / "out" / JOURNAL).read_bytes().count(b"\n")
    words = ("--format", "png16", "--format", "exr")
    by_name = kept(cli, "--out", "out", *words)
    assert 15 <= sum(by_name.values()) <= before
    assert cli("batch", "in", "--out", "once", *words).returncode == 0
    assert len(outputs(cli.folder / "out")) == 2 * COUNT
    assert outputs(cli.folder / "out") == outputs(cli.folder / "once")
    first, other = (rows(cli, out) for out in ("once", "out"))
    assert list(first) == list(other)
    for name, row in first.items():
        assert {**row, "seconds": 0} == {**other[name], "seconds": 0}


@pytest.mark.parametrize("which", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_batch_can_go_on(cli: Cli, which: signal.Signals) -> None:
    many(cli)
    running = begun(cli, 5)
    running.send_signal(which)
    out, err = running.communicate(timeout=30)
    assert running.returncode == 128 + which
    assert b"run the same command again to resume" in err
    assert b"manifest: out/manifest.jsonl" in out
    done = rows(cli, "out")
    assert 5 <= len(done) < COUNT
    assert f"{len(done)} of {COUNT} inputs done".encode() in out
    assert list(done) == sorted(done)
    assert {file["path"] for row in done.values() for file in row["outputs"]} == {
        *outputs(cli.folder / "out")
    }
    by_name = kept(cli, "--out", "out")
    assert {name for name, was in by_name.items() if was} == done.keys()
    cli("batch", "in", "--out", "once")
    assert outputs(cli.folder / "out") == outputs(cli.folder / "once")


def test_a_changed_model_is_done_again(inside: Cli) -> None:
    tree(inside, "a.png")
    inside("batch", "in", "--out", "out")
    write_model(inside.models / "default", b"no onnx file")
    assert inside("batch", "in", "--out", "out").returncode == 3
    assert rows(inside, "out").keys() == {"a.png"}
    from_other = write_model(inside.models / "other", output__shift=6.0)
    assert kept(inside, "--out", "out", "--model", str(from_other)) == {"a.png": False}


@contextmanager
def watching(cli: Cli, *words: str) -> Iterator[Iterator[dict[str, Any]]]:
    """The objects that ``--json`` prints, while the batch goes on."""
    process = subprocess.Popen(
        cli.command("batch", "in", "-o", "out", "--watch", "--json", *words),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=cli.folder,
        env=cli.environment,
    )
    try:
        assert process.stdout is not None
        yield map(json.loads, process.stdout)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 128 + signal.SIGINT
    finally:
        process.kill()
        process.communicate()


def test_new_and_changed_files_are_processed_once(cli: Cli) -> None:
    write_image(cli.folder / "in" / "a.png")
    with watching(cli) as results:
        assert next(results)["input"] == "a.png"
        write_image(cli.folder / "in" / "deep" / "b.png")
        assert next(results)["input"] == "deep/b.png"
        write_image(cli.folder / "in" / "deep" / "b.jpg")  # the output of b.png stays
        assert next(results)["outputs"][0]["path"] == "deep/b.jpg.depth.png"
        write_image(cli.folder / "in" / "a.png", synthetic_image(40, 50))
        changed = next(results)
    assert (changed["input"], changed["kept"]) == ("a.png", False)
    rows = (cli.folder / "out" / "manifest.jsonl").read_text().splitlines()
    assert {json.loads(row)["input"]: json.loads(row)["status"] for row in rows} == {
        "a.png": "ok",
        "deep/b.jpg": "ok",
        "deep/b.png": "ok",
    }
    assert kept(cli, "-o", "out") == {"a.png": True, "deep/b.jpg": True, "deep/b.png": False}


def test_a_file_is_processed_when_it_is_complete(cli: Cli) -> None:
    whole = write_image(cli.folder / "in" / "a.png").read_bytes()
    with watching(cli) as results:
        assert next(results)["input"] == "a.png"
        with (cli.folder / "in" / "b.png").open("wb") as file:
            for start in range(0, len(whole), 1 + len(whole) // 8):  # longer than a file settles
                file.write(whole[start : start + 1 + len(whole) // 8])
                file.flush()
                for _ in range(3):  # other files arrive in between
                    time.sleep(0.1)
                    (cli.folder / "in" / "notes.txt").write_text("")
        result = next(results)
    assert (result["input"], result["status"]) == ("b.png", "ok")


def test_needs_a_local_folder_and_its_extra(inside: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    write_image(inside.folder / "in" / "a.png")
    assert inside("batch", "--files", "list", "-o", "out", "--watch").returncode == 2
    monkeypatch.delitem(sys.modules, "depthcli.jobs.batch.plan", raising=False)
    monkeypatch.setitem(sys.modules, "watchfiles", None)
    done = inside("batch", "in", "-o", "out", "--watch")
    assert (done.returncode, b"[watch]" in done.stderr) == (3, True)


def test_shards_are_summed_up_listed_and_merged(inside: Cli) -> None:
    tree(inside, "a.png", "hall/b.png")
    (inside.folder / "in" / "bad\tname.png").touch()
    codes = [inside("batch", "in", "-o", "out", "--shard", f"{n}/2").returncode for n in (1, 2)]
    assert sorted(codes) == [0, 1]
    lines = inside("manifest", "summary", "out").stdout.decode().splitlines()
    assert lines[0] == "3 inputs: 2 ok, 1 failed"
    assert lines[1].startswith("2 outputs, ")
    (facts,) = printed(inside("manifest", "summary", "out", "--json"))
    assert (facts["inputs"], facts["failed"], facts["outputs"]) == (3, 1, 2)
    assert [model["inputs"] for model in facts["models"]] == [3]
    assert {"model", "model_sha256", "version"} < set(facts["models"][0])
    failed = inside("manifest", "failed", "out")
    assert failed.stdout.decode().count("\n") == 1
    assert "is empty" in failed.stdout.decode()
    (row,) = printed(inside("manifest", "failed", "out", "--json"))
    assert (row["input"], row["status"]) == ("bad\tname.png", "failed")
    merged = printed(inside("manifest", "merge", "out", "--json"))
    assert merged == [{"manifest": "out/manifest.jsonl"}]
    left = {name.split("/")[0] for name in contents(inside, "out")}
    assert left == {"a.depth.png", "hall", "manifest.jsonl"}
    assert json.loads(inside("manifest", "summary", "out", "--json").stdout) == facts
    with (inside.folder / "out" / "manifest.jsonl").open("ab") as file:
        file.write(b'{"input": "cut\n')
    assert b"line 4 is no row" in inside("manifest", "summary", "out", code=0).stderr


NAMES = ("a.png", "b.png", "c.png")
"""Of two sizes, so that images of one can be given to the network together."""
WAYS = {
    "one at a time": ("batch", "in", "--workers", "1", "--threads", "1", "--batch-size", "1"),
    "several at a time": ("batch", "in", "--workers", "3", "--threads", "1", "--batch-size", "1"),
    "several threads": ("batch", "in", "--workers", "1", "--threads", "3", "--batch-size", "1"),
    "several in a batch": ("batch", "in", "--workers", "1", "--threads", "2", "--batch-size", "4"),
    "the other way round": ("batch", "in", "--files", "list.txt", "--workers", "2"),
    "images alone": ("predict", *(f"in/{name}" for name in NAMES), "--threads", "2"),
    "images in another order": ("predict", *(f"in/{name}" for name in NAMES[::-1])),
}


@pytest.mark.parametrize("model", ["default", "float"])
def test_no_byte_depends_on_how_the_work_is_spread(model: str, inside: Cli) -> None:
    room = cv2.imread(str(ROOT / "docs" / "room.jpg"))
    for name, size in zip(NAMES, ((120, 90), (120, 90), (100, 100)), strict=True):
        image(inside, name, cv2.resize(room, size) // (1 + NAMES.index(name)))
    write_mp4(inside.folder / "in" / "d.mp4", [cv2.resize(room, (64, 48)) // n for n in (1, 2, 3)])
    (inside.folder / "list.txt").write_text("\n".join(["d.mp4", *NAMES[::-1]]))
    data_of = {}
    for number, (way, words) in enumerate(WAYS.items()):
        more = ("--model", str(ROOT / "models" / model), "--format", "npy", "--format", "png16")
        inside(*words, "-o", f"{number}/", "--quiet", *more, code=0)
        files = contents(inside, str(number))
        data_of[way] = {name: data for name, data in files.items() if name != "manifest.jsonl"}
    whole = data_of["one at a time"]
    assert len(whole) == 2 * len(NAMES) + 4  # of the video one file and three images
    for way, files in data_of.items():
        images = {name: whole[name] for name in whole if not name.startswith("d.")}
        assert files == (images if way.startswith("images") else whole), way
