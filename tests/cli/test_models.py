"""``depthcli models``."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING

import pytest
from helpers.command_line import ROOT
from helpers.tiny import write_model, write_picture

if TYPE_CHECKING:
    from helpers.command_line import Cli


def spoil(cli: Cli, name: str) -> None:
    path = write_model(cli.models / name) / "model.onnx"
    path.write_bytes(path.read_bytes()[:-1] + b"\0\0")


def test_the_list_shows_what_is_there(inside: Cli) -> None:
    write_model(inside.models / "other", version="7.7")
    plain, told = inside("models"), inside("models", "list")
    assert plain.returncode == told.returncode == 0
    assert plain.stdout == told.stdout
    header, *rows = (line.split("\t") for line in told.stdout.decode().splitlines())
    assert header[:3] == ["name", "version", "kind"]
    assert ["other", "7.7", "metric"] in [row[:3] for row in rows]
    assert "default" in [row[0] for row in rows]


@pytest.mark.parametrize("columns", [30, 60, 100, 300])
def test_no_terminal_is_too_narrow_for_names_and_paths(cli: Cli, columns: int) -> None:
    long_name = "a-model-with-rather-a-long-name"
    write_model(cli.models / long_name)
    code, shown = cli.on_a_terminal("models", columns=columns)
    assert code == 0
    assert str(cli.models / long_name / "card.json") in shown
    code, shown = cli.on_a_terminal("models", "cards", columns=columns)
    assert code == 0
    for line in cli("models", "cards").stdout.decode().splitlines()[1:]:
        for cell in line.split("\t"):
            assert cell in shown


@pytest.mark.parametrize("words", [("models",), ("models", "cards")])
def test_columns_are_aligned_on_a_terminal_that_is_wide_enough(
    cli: Cli, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    header, *rows = (line.split("\t") for line in cli(*words).stdout.decode().splitlines())
    _, shown = cli.on_a_terminal(*words, columns=300)
    lines = shown.splitlines()[: 1 + len(rows)]
    for column, name in enumerate(header):
        start = lines[0].index(name)
        for line, row in zip(lines[1:], rows, strict=True):
            assert line[start:].startswith(row[column])
            assert start == 0 or line[start - 1] == " "


def test_the_bundled_models_are_in_the_wheel_and_run(inside: Cli) -> None:
    nothing_else = {"DEPTHCLI_MODELS": ""}
    listed = inside("models", "list", "--json", **nothing_else).stdout.splitlines()
    models = {row["name"]: row for row in map(json.loads, listed)}
    assert models.keys() == {"default", "fast", "float"}
    write_picture(inside.folder / "a.png")
    words = ("predict", "a.png", "-o", "a.npy", "--json", "--model", "fast")
    told = json.loads(inside(*words, **nothing_else).stdout)
    assert (told["status"], told["model"]) == ("ok", "fast")
    data = (ROOT / "models" / "fast" / "model.onnx").read_bytes()
    assert told["model_sha256"] == models["fast"]["sha256"] == hashlib.sha256(data).hexdigest()


def test_the_list_for_machines(inside: Cli) -> None:
    spoil(inside, "broken")
    done = inside("models", "list", "--json")
    models = {m["name"]: m for m in map(json.loads, done.stdout.splitlines())}
    assert done.returncode == 3
    assert models["default"]["status"] == "ok"
    assert models["broken"]["status"] == "failed"
    assert "bytes" in models["broken"]["error"]


def test_show_prints_the_card(inside: Cli) -> None:
    done = inside("models", "show")
    card = json.loads(done.stdout)
    assert done.returncode == 0
    assert card == json.loads((inside.models / "default" / "card.json").read_text()) | {
        "training": {},
        "scores": {},
        "latency": {},
    }


def test_verify_runs_each_model(inside: Cli) -> None:
    done = inside("models", "verify", "default")
    assert done.returncode == 0
    assert done.stdout.startswith(b"default: ok, sha256 ")


def test_verify_goes_on_after_a_broken_one(inside: Cli) -> None:
    spoil(inside, "broken")
    done = inside("models", "verify", "broken", "default")
    assert done.returncode == 3
    assert done.stdout.startswith(b"default: ok")
    (line,) = done.stderr.decode().splitlines()
    assert "bytes" in line


def test_verify_for_machines(inside: Cli) -> None:
    spoil(inside, "broken")
    done = inside("models", "verify", "--json", "broken", "default")
    failed, fine = map(json.loads, done.stdout.splitlines())
    assert (failed["name"], failed["status"]) == ("broken", "failed")
    assert (fine["name"], fine["status"]) == ("default", "ok")
    assert len(fine["sha256"]) == 64
