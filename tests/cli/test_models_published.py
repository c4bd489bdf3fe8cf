"""``depthcli models add NAME``: a model from the address that its card states."""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import Cli
from helpers.tiny import card_with, tiny_onnx, write_image
from helpers.web import FileServer

from depthcli.io.storage.atomic import open_locked
from depthcli.models.catalog import ready_card, ready_names

PAGE = "https://example.org/weights"
AT_ONCE = {"DEPTHCLI_RETRIES": "0"}


@pytest.fixture
def server() -> Iterator[FileServer]:
    with FileServer(tiny_onnx()) as running:
        yield running


def write_published(cli: Cli, url: str, **facts: Any) -> str:
    """A card of the tiny model that states an address."""
    weights = {"page": PAGE, "url": url, **facts}
    fields = card_with({"weights": weights, "name": "far"})
    del fields["onnx"]
    (cli.folder / "far.json").write_text(json.dumps(fields))
    return "far.json"


def pinned(data: bytes) -> dict[str, Any]:
    return {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}


def part(cli: Cli) -> Path:
    return cli.models / ".far.part"


def test_model_is_downloaded_added_and_runs(cli: Cli, server: FileServer) -> None:
    card = write_published(cli, server.url, **pinned(server.data))
    added = cli("models", "add", card, code=0)
    assert all(fact in added.stderr.decode() for fact in (server.url, "0.0 MB", "licence MIT"))
    assert "metres need no focal length" in added.stderr.decode()
    write_image(cli.folder / "a.png")
    used = json.loads(cli("predict", "a.png", "-o", "a.npy", "--model", "far", "--json").stdout)
    assert used["model_sha256"] == hashlib.sha256(server.data).hexdigest()
    assert not part(cli).exists()
    assert server.starts == [0]
    cli("models", "add", card, code=2)  # the name is taken
    assert server.starts == [0]


@pytest.mark.parametrize("has_ranges", [True, False])
def test_interrupted_download_goes_on(inside: Cli, server: FileServer, has_ranges: bool) -> None:
    card = write_published(inside, server.url, **pinned(server.data))
    server.cut_after = 50
    cut = inside("models", "add", card, **AT_ONCE, code=3)
    assert cut.stderr.splitlines()[-1].count(server.url.encode()) == 1
    assert part(inside).read_bytes() == server.data[:50]
    assert not (inside.models / "far").exists()
    server.cut_after, server.has_ranges = None, has_ranges
    assert inside("models", "add", card, **AT_ONCE).returncode == 0
    assert server.starts == [0, 50 if has_ranges else 0]
    assert (inside.models / "far/model.onnx").read_bytes() == server.data
    assert not part(inside).exists()


def test_another_part_than_that_asked_for_is_refused(inside: Cli, server: FileServer) -> None:
    part(inside).write_bytes(server.data[:50])
    server.shift = 3
    refused = inside("models", "add", write_published(inside, server.url, **pinned(server.data)))
    assert (refused.returncode, b"another part of it" in refused.stderr) == (3, True)


def test_download_goes_on_by_itself_where_it_is_cut(inside: Cli, server: FileServer) -> None:
    server.cut_after = 100
    assert inside("models", "add", write_published(inside, server.url)).returncode == 0
    assert server.starts == list(range(0, len(server.data), 100))


def test_complete_part_is_not_downloaded_again(inside: Cli, server: FileServer) -> None:
    part(inside).write_bytes(server.data)
    card = write_published(inside, server.url, **pinned(server.data))
    assert inside("models", "add", card).returncode == 0
    assert server.starts == []


def test_file_with_another_checksum_is_refused(inside: Cli, server: FileServer) -> None:
    card = write_published(inside, server.url, **pinned(server.data))
    good, server.data = server.data, server.data + b"\x72\x00"  # an empty metadata entry
    refused = inside("models", "add", card, code=3)
    assert hashlib.sha256(server.data).hexdigest().encode() in refused.stderr
    assert str(part(inside)).encode() not in refused.stderr
    assert not (inside.models / "far").exists()
    server.data = good
    assert inside("models", "add", card).returncode == 0  # begins anew


def test_checksum_that_is_not_published_is_recorded(inside: Cli, server: FileServer) -> None:
    part(inside).write_bytes(b"the beginning of another file")
    added = inside("models", "add", write_published(inside, server.url), "--json", code=0)
    facts = json.loads(added.stdout)
    assert facts["sha256"] == hashlib.sha256(server.data).hexdigest()
    assert (facts["url"], facts["license"]) == (server.url, "MIT")
    card_ = json.loads(inside("models", "show", "far").stdout)
    assert (card_["sha256"], card_["weights"]["url"]) == (facts["sha256"], server.url)


def test_without_network_the_address_is_said(inside: Cli, server: FileServer) -> None:
    server.__exit__(None, None, None)
    failed = inside("models", "add", write_published(inside, server.url), **AT_ONCE, code=3)
    (line,) = failed.stderr.splitlines()[1:]
    assert server.url.encode() in line
    assert b"--card far.json" in line
    assert not part(inside).exists()


def test_two_processes_do_not_write_one_download(inside: Cli, server: FileServer) -> None:
    card = write_published(inside, server.url, **pinned(server.data))
    assert open_locked(part(inside)) is not None
    assert inside("models", "add", card).returncode == 2
    assert server.starts == []


def test_card_without_address_says_where_weights_are(inside: Cli) -> None:
    fields = json.loads(inside("models", "show", "fastdepth").stdout)
    (inside.folder / "mine.json").write_text(json.dumps(fields | {"weights": {"page": PAGE}}))
    refused = inside("models", "add", "mine.json", code=2)
    assert PAGE.encode() in refused.stderr


def test_every_ready_card_states_an_address_that_a_hint_names(inside: Cli, image: Path) -> None:
    cards = [json.loads(line) for line in inside("models", "cards", "--json").stdout.splitlines()]
    by_name = {card["name"]: card["weights"] for card in cards}
    for name, weights in by_name.items():
        assert weights["page"]
        assert "source" in weights or "url" not in weights
        failed = inside("predict", image, "--model", name, code=3)
        assert (weights.get("url") or weights["page"]).encode() in failed.stderr


def test_cards_show_the_addresses_of_weights(inside: Cli) -> None:
    rows = inside("models", "cards").stdout.decode().splitlines()
    text = inside("models", "cards", "depth-anything-v2-small").stdout.decode()
    weights = json.loads(inside("models", "show", "depth-anything-v2-small").stdout)["weights"]
    assert any(weights["page"] in row for row in rows)
    assert all(weights[fact] in text for fact in ("page", "url", "sha256"))
    assert inside("models", "cards", "none").returncode == 2


def test_download_has_a_bar_on_a_terminal(cli: Cli, server: FileServer) -> None:
    card = write_published(cli, server.url, **pinned(server.data))
    code, output = cli.on_a_terminal("models", "add", card)
    assert code == 0
    assert "1/1" in output
    assert "MB/s" in output


def test_a_mirror_of_the_hub_is_asked_with_the_token(inside: Cli, server: FileServer) -> None:
    mirror, hub = server.url.rpartition("/")[0], "https://huggingface.co"
    variables = {"HF_ENDPOINT": mirror, "HF_TOKEN": "secret"}
    card = write_published(inside, f"{hub}/a/resolve/main/model.onnx", **pinned(server.data))
    added = inside("models", "add", card, **variables)
    assert (added.returncode, server.tokens) == (0, ["Bearer secret"])
    elsewhere = {**variables, "HF_ENDPOINT": f"{mirror}/other"}  # the token is of no other server
    other = write_published(inside, server.url, **pinned(server.data))
    assert inside("models", "add", other, "--force", **elsewhere).returncode == 0
    assert server.tokens[1:] == [None]


@pytest.mark.parametrize(
    "name", [name for name in ready_names() if not ready_card(name).weights.url]
)
def test_a_ready_card_without_a_file_says_how_to_make_one(name: str, inside: Cli) -> None:
    """7 cards ended with "onnx.opset is missing", 15 stated no command."""
    refused = inside("models", "add", name, code=2)
    for words in ("states no address of an ONNX file", f"'depthcli models cards {name}'"):
        assert words.encode() in refused.stderr
    card = ready_card(name)
    assert (card.weights.export is None) == (card.verification.package is None)
