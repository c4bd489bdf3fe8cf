"""A batch that is run again: after a stop, after a change, and while another one runs."""

import signal
import subprocess
import time

import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.folders import contents, picture, printed, rows, tree
from helpers.tiny import write_model

JOURNAL = ".depthcli-batch.jsonl"
COUNT = 120


def many(cli: Cli) -> None:
    """Pictures that take a while, no two alike, in two folders."""
    random = np.random.default_rng(0)
    for number in range(COUNT):
        pixels = random.integers(0, 256, (200, 300), dtype=np.uint8)
        picture(cli, f"{number % 2}/{number:03}.png", pixels)


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


def maps(cli: Cli, out: str) -> dict[str, bytes]:
    """Everything but the manifest, whose seconds differ."""
    return {name: data for name, data in contents(cli, out).items() if name != "manifest.jsonl"}


def kept(cli: Cli, *words: str) -> dict[str, bool]:
    """Which inputs were already done."""
    return {row["input"]: row["kept"] for row in printed(cli("batch", "in", *words, "--json"))}


@pytest.mark.parametrize("after", [1, 25])
def test_a_killed_batch_goes_on_and_gives_the_same_bytes(cli: Cli, after: int) -> None:
    many(cli)
    running = begun(cli, after, "--format", "png16", "--format", "exr")
    running.kill()
    assert running.wait(timeout=30) == -signal.SIGKILL
    # What was being written when the power went.
    (cli.folder / "out" / "0" / ".depthcli-0123456789abcdef.png").write_bytes(b"half a pict")
    with (cli.folder / "out" / JOURNAL).open("ab") as journal:
        journal.write(b'{"input": "0/0')
    before = (cli.folder / "out" / JOURNAL).read_bytes().count(b"\n")
    words = ("--format", "png16", "--format", "exr")
    found = kept(cli, "--out", "out", *words)
    assert after <= sum(found.values()) <= before
    assert cli("batch", "in", "--out", "once", *words).returncode == 0
    assert len(maps(cli, "out")) == 2 * COUNT
    assert maps(cli, "out") == maps(cli, "once")
    one, other = (rows(cli, out) for out in ("once", "out"))
    assert list(one) == list(other)
    for name, row in one.items():
        assert {**row, "seconds": 0} == {**other[name], "seconds": 0}


@pytest.mark.parametrize(
    ("which", "code"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)],
    ids=["int", "term", "hup"],
)
def test_an_interrupted_batch_can_go_on(cli: Cli, which: signal.Signals, code: int) -> None:
    many(cli)
    running = begun(cli, 5)
    running.send_signal(which)
    out, err = running.communicate(timeout=30)
    assert running.returncode == code
    assert b"run the same command again to resume" in err
    assert b"manifest: out/manifest.jsonl" in out
    done = rows(cli, "out")
    assert 5 <= len(done) < COUNT
    assert f"{len(done)} of {COUNT} inputs done".encode() in out
    assert list(done) == sorted(done)
    assert {file["path"] for row in done.values() for file in row["outputs"]} == {*maps(cli, "out")}
    found = kept(cli, "--out", "out")
    assert {name for name, was in found.items() if was} == done.keys()
    cli("batch", "in", "--out", "once")
    assert maps(cli, "out") == maps(cli, "once")


def test_a_changed_model_is_done_again(inside: Cli) -> None:
    tree(inside, "a.png")
    inside("batch", "in", "--out", "out")
    write_model(inside.models / "default", b"no onnx file")
    assert inside("batch", "in", "--out", "out").returncode == 3
    assert rows(inside, "out").keys() == {"a.png"}
    from_other = write_model(inside.models / "other", output__shift=6.0)
    assert kept(inside, "--out", "out", "--model", str(from_other)) == {"a.png": False}
