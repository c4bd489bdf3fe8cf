"""``depthcli batch --watch``: a folder whose files come while the batch runs."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from helpers.command_line import Cli
from helpers.tiny import synthetic_picture, write_picture


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
    write_picture(cli.folder / "in" / "a.png")
    with watching(cli) as results:
        assert next(results)["input"] == "a.png"
        write_picture(cli.folder / "in" / "deep" / "b.png")
        (cli.folder / "in" / "notes.txt").write_text("")
        assert next(results)["input"] == "deep/b.png"
        write_picture(cli.folder / "in" / "a.png", synthetic_picture(40, 50))
        changed = next(results)
    assert (changed["input"], changed["kept"]) == ("a.png", False)
    rows = (cli.folder / "out" / "manifest.jsonl").read_text().splitlines()
    assert {json.loads(row)["input"]: json.loads(row)["status"] for row in rows} == {
        "a.png": "ok",
        "deep/b.png": "ok",
    }
    done = cli("batch", "in", "-o", "out", "--json")
    assert all(json.loads(line)["kept"] for line in done.stdout.splitlines())


def test_a_file_is_processed_when_it_is_complete(cli: Cli) -> None:
    whole = write_picture(cli.folder / "in" / "a.png").read_bytes()
    with watching(cli) as results:
        assert next(results)["input"] == "a.png"
        with (cli.folder / "in" / "b.png").open("wb") as file:
            for start in range(0, len(whole), 1 + len(whole) // 8):  # longer than a file settles
                file.write(whole[start : start + 1 + len(whole) // 8])
                file.flush()
                time.sleep(0.3)
        result = next(results)
    assert (result["input"], result["status"]) == ("b.png", "ok")


def test_needs_a_local_folder_and_its_extra(inside: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    write_picture(inside.folder / "in" / "a.png")
    assert inside("batch", "--files", "list", "-o", "out", "--watch").returncode == 2
    monkeypatch.delitem(sys.modules, "depthcli.jobs.batch.watch", raising=False)
    monkeypatch.setitem(sys.modules, "watchfiles", None)
    done = inside("batch", "in", "-o", "out", "--watch")
    assert (done.returncode, b"[watch]" in done.stderr) == (2, True)
