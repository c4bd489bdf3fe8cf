"""A model is found by name or path, and never used unchecked."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny import card_with, load, tiny_onnx, write_model

from depthcli.core.types import Frame
from depthcli.errors import ModelError
from depthcli.models import catalog


def test_a_name_wins_over_a_folder_of_that_name_here(
    models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_model(models / "tiny", version="shelf")
    write_model(tmp_path / "here" / "tiny", version="here")
    monkeypatch.chdir(tmp_path / "here")
    assert catalog.find_model("tiny").card.version == "shelf"
    assert catalog.find_model("./tiny").card.version == "here"


def test_a_card_may_be_inside_or_beside_one_onnx_file(models: Path) -> None:
    models.mkdir()
    path = models / "single.onnx"
    path.write_bytes(tiny_onnx(card=json.dumps(card_with({"name": "alone"}))))
    for model in (catalog.find_model(path), catalog.find_model("single")):
        assert (model.path, model.card.name) == (path, "alone")
    path.write_bytes(tiny_onnx())
    (models / "single.card.json").write_text(json.dumps(card_with({"name": "beside"})))
    assert catalog.find_model(path).card.name == "beside"


@pytest.mark.parametrize("name", ["nothing", "./nothing", "nothing.onnx", "/", "", "last.ckpt"])
@pytest.mark.usefixtures("models")
def test_unknown_model_is_an_error_and_a_checkpoint_is_told_from_one(name: str) -> None:
    with pytest.raises(ModelError, match="export-onnx" if name == "last.ckpt" else None):
        catalog.find_model(name)


def test_another_checksum_or_size_or_no_file_is_refused(model_folder: Path) -> None:
    path = model_folder / "model.onnx"
    data = path.read_bytes()
    for other in (data[:-1] + bytes([data[-1] ^ 1]), data[:-5]):
        path.write_bytes(other)
        with pytest.raises(ModelError):
            catalog.find_model(model_folder)
    path.unlink()
    with pytest.raises(ModelError):
        catalog.find_model(model_folder)


def _message(number: int, body: bytes) -> bytes:
    """A field of a protobuf message, its key and length in more bytes than they need."""
    key, length = number << 3 | 2, len(body)
    assert length < 2**14
    return bytes([key & 0x7F | 0x80, key >> 7, length & 0x7F | 0x80, length >> 7 | 0x80, 0]) + body


WHOLE = tiny_onnx(card=json.dumps(card_with({})))
_ELSEWHERE = {
    "by its location alone": b"\x70\x01",
    "by its location, in three bytes": b"\x70\x81\x80\x00",
    "by a key in more bytes": _message(13, b"\x0a\x88\x00location\x12\x01x"),
    "by a tag in more bytes": _message(13, b"\x8a\x00\x08location\x12\x01x"),
}
_PLACES = {
    "an initializer": lambda tensor: _message(7, _message(5, tensor)),
    "a constant": lambda tensor: _message(7, _message(1, _message(5, _message(5, tensor)))),
    "a list of tensors": lambda tensor: _message(7, _message(1, _message(5, _message(10, tensor)))),
    "a sparse tensor": lambda tensor: _message(7, _message(15, _message(1, tensor))),
    "a branch": lambda tensor: _message(
        7, _message(1, _message(5, _message(6, _message(5, tensor))))
    ),
    "a function": lambda tensor: _message(25, _message(7, _message(5, _message(5, tensor)))),
}


@pytest.mark.parametrize("place", _PLACES)
@pytest.mark.parametrize("how", _ELSEWHERE)
def test_hidden_external_data_is_refused(tmp_path: Path, place: str, how: str) -> None:
    path = tmp_path / "m.onnx"
    path.write_bytes(WHOLE + _PLACES[place](b"\x42\x01w"))  # a name does no harm
    assert catalog.find_model(path).card.name == "tiny"
    path.write_bytes(WHOLE + _PLACES[place](_ELSEWHERE[how]))
    with pytest.raises(ModelError):
        catalog.find_model(path)


REFUSED = {
    "nothing": b"",
    "text": b"hello, world",
    "an image": b"\x89PNG\r\n",
    "zeros": b"\x00" * 64,
    "a field alone": b"\x08\x08",
    "a network without a card": tiny_onnx(),
    # data_location with bit 32 set, which libraries drop, and then read weights elsewhere
    "a tag of 33 bits": WHOLE + _message(7, _message(5, b"\xf0\x80\x80\x80\x10\x01")),
    **{f"{length} bytes": WHOLE[:length] for length in range(7, len(WHOLE) - 1, 7)},
}


@pytest.mark.parametrize("what", REFUSED)
def test_file_that_is_no_whole_model_is_refused(tmp_path: Path, what: str) -> None:
    path = tmp_path / "m.onnx"
    path.write_bytes(REFUSED[what])
    with pytest.raises(ModelError):
        catalog.find_model(path)


def test_the_complete_card_of_the_docs_works_beside_its_file(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "models.md").read_text("utf-8")
    card = page.split("A complete card:\n\n```json\n")[1].partition("```")[0]
    (tmp_path / "mean.card.json").write_text(card)
    (tmp_path / "mean.onnx").write_bytes(tiny_onnx(channels=3))
    model = catalog.find_model(tmp_path / "mean.onnx")
    assert (model.card.name, model.card.onnx.opset, model.card.onnx.ir) == ("mean", 17, 8)


def test_a_card_of_any_size_on_a_network_of_one_says_what_to_set(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "fixed", tiny_onnx(size=(12, 16)), input__fit="keep-aspect")
    with pytest.raises(ModelError, match=r"input\.dynamic to false"):
        load(folder).predict(Frame(np.zeros((30, 90), np.uint8)))


def test_a_pipe_or_a_device_is_not_waited_for(model_folder: Path) -> None:
    file = model_folder / "model.onnx"
    for make in (os.mkfifo, lambda path: path.symlink_to("/dev/zero")):
        file.unlink()
        make(file)
        with pytest.raises(ModelError, match="pipe or a device"):
            catalog.find_model(model_folder)
