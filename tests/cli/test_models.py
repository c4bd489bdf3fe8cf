"""``depthcli models``."""

import hashlib
import json

from helpers.command_line import ROOT, Cli
from helpers.tiny import write_model, write_picture


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
