"""``depthcli models``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from tiny import write_model

if TYPE_CHECKING:
    from conftest import Cli


def spoil(cli: Cli, name: str) -> None:
    path = write_model(cli.models / name) / "model.onnx"
    path.write_bytes(path.read_bytes()[:-1] + b"\0\0")


def test_the_list_shows_what_is_there(cli: Cli) -> None:
    write_model(cli.models / "other", version="7.7")
    plain, told = cli("models"), cli("models", "list")
    assert plain.returncode == told.returncode == 0
    assert plain.stdout == told.stdout
    header, *rows = (line.split("\t") for line in told.stdout.decode().splitlines())
    assert header[:3] == ["name", "version", "kind"]
    assert ["other", "7.7", "metric"] in [row[:3] for row in rows]
    assert "default" in [row[0] for row in rows]


def test_the_list_for_machines(cli: Cli) -> None:
    spoil(cli, "broken")
    done = cli("models", "list", "--json")
    models = {m["name"]: m for m in map(json.loads, done.stdout.splitlines())}
    assert done.returncode == 3
    assert models["default"]["status"] == "ok"
    assert models["broken"]["status"] == "failed"
    assert "bytes" in models["broken"]["error"]


def test_show_prints_the_card(cli: Cli) -> None:
    done = cli("models", "show")
    card = json.loads(done.stdout)
    assert done.returncode == 0
    assert card == json.loads((cli.models / "default" / "card.json").read_text()) | {
        "training": {},
        "scores": {},
        "latency": {},
    }


def test_verify_runs_each_model(cli: Cli) -> None:
    done = cli("models", "verify", "default")
    assert done.returncode == 0
    assert done.stdout.startswith(b"default: ok, sha256 ")


def test_verify_goes_on_after_a_broken_one(cli: Cli) -> None:
    spoil(cli, "broken")
    done = cli("models", "verify", "broken", "default")
    assert done.returncode == 3
    assert done.stdout.startswith(b"default: ok")
    (line,) = done.stderr.decode().splitlines()
    assert "bytes" in line


def test_verify_for_machines(cli: Cli) -> None:
    spoil(cli, "broken")
    done = cli("models", "verify", "--json", "broken", "default")
    failed, fine = map(json.loads, done.stdout.splitlines())
    assert (failed["model"], failed["status"]) == ("broken", "failed")
    assert (fine["model"], fine["status"]) == ("default", "ok")
    assert len(fine["sha256"]) == 64
