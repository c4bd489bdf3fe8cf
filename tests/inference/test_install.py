"""Models of your own: complete or not there at all."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import onnx
import pytest
from helpers.tiny import card_with, fixed_inside, tiny_onnx, write_model
from onnx import external_data_helper

from depthcli.errors import DepthcliError, ModelError, OutputError, UsageError
from depthcli.io.storage.atomic import workspace
from depthcli.jobs.models import add_model, remove_model, verify_models
from depthcli.models.catalog import find_model, onnx_facts


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """An ONNX file without a card."""
    path = tmp_path / "download.onnx"
    path.write_bytes(tiny_onnx())
    return path


def write_card(path: Path, **changes: object) -> str:
    """The tiny card without what a file would add."""
    card = card_with({name.replace("__", "."): value for name, value in changes.items()})
    del card["onnx"]
    path.write_text(json.dumps(card))
    return str(path)


def test_a_taken_name_is_said_before_anything_is_fetched(models: Path, tmp_path: Path) -> None:
    write_model(models / "mine")
    with pytest.raises(UsageError):
        add_model(tmp_path / "none.onnx", name="mine")
    with pytest.raises(ModelError):
        add_model(tmp_path / "none.onnx", name="mine", force=True)


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden", "a.onnx", "ä", "x" * 101, "a\n"])
def test_a_name_that_is_no_file_name_is_refused(models: Path, file: Path, name: str) -> None:
    card = write_card(file.with_name("c.json"))
    with pytest.raises(DepthcliError):
        add_model(file, card, name=name)
    assert not models.exists()


def test_the_card_inside_or_beside_is_enough(models: Path, tmp_path: Path) -> None:
    inside, beside = tmp_path / "inside.onnx", tmp_path / "beside.onnx"
    inside.write_bytes(tiny_onnx(card=json.dumps(card_with({"name": "in"}))))
    beside.write_bytes(tiny_onnx())
    write_card(tmp_path / "beside.card.json", name="by")
    folder = write_model(tmp_path / "folder", name="folder")
    assert add_model(inside).card.name == "in"
    assert add_model(beside).card.name == "by"
    assert add_model(folder / "model.onnx").card.name == "folder"
    assert sorted(p.name for p in models.iterdir()) == ["by", "folder", "in"]
    beside.with_name("beside.card.json").unlink()
    write_card(tmp_path / "card.json", file="other.onnx")
    with pytest.raises(UsageError, match=r"card\.json is that of other\.onnx"):
        add_model(beside)
    with pytest.raises(ModelError, match=r"card\.json is that of other\.onnx"):
        find_model(beside)


def test_a_graph_of_one_size_says_how_to_state_it(models: Path, tmp_path: Path) -> None:
    (tmp_path / "a.onnx").write_bytes(fixed_inside())
    card = write_card(tmp_path / "c.json", input__fit="keep-aspect")
    with pytest.raises(ModelError):
        add_model(tmp_path / "a.onnx", card)
    assert not list(models.glob("tiny"))
    follows = write_card(tmp_path / "c.json", input__dynamic=False, input__fit="stretch")
    add_model(tmp_path / "a.onnx", follows)
    ((_, outcome),) = verify_models(["tiny"])
    assert not isinstance(outcome, DepthcliError)
    changed = json.loads((models / "tiny/card.json").read_text())
    changed["input"] |= {"dynamic": True, "fit": "keep-aspect"}
    (models / "tiny/card.json").write_text(json.dumps(changed))
    ((_, outcome),) = verify_models(["tiny"])
    assert isinstance(outcome, DepthcliError)
    assert "16 x 12" in str(outcome)


def test_a_taken_name_needs_force(models: Path, file: Path, tmp_path: Path) -> None:
    card = write_card(tmp_path / "c.json")
    add_model(file, card)
    (models / "tiny" / "card.json").touch()
    before = find_model("tiny")
    file.write_bytes(tiny_onnx(stride=2))
    with pytest.raises(UsageError):
        add_model(file, card)
    assert find_model("tiny").sha256 == before.sha256
    after = add_model(file, card, force=True)
    assert after.sha256 != before.sha256
    assert after.card.file != before.card.file  # so that the old one stays whole to the end
    assert find_model("tiny").sha256 == after.sha256
    assert [p.name for p in models.iterdir()] == ["tiny"]


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"input__colour": "rgb"}, "but its card says 3 channels"),
        ({"input__width": 0}, "input.width"),
        ({"sha256": "0" * 64}, "checksum"),
        ({"bytes": 7}, "its card says 7"),
        ({"surprise": 1}, "surprise"),
        (
            {"output__scale": -1.0, "output__shift": 0.0, "output__transform": "reciprocal"},
            "no depth",
        ),
    ],
)
def test_model_that_does_not_fit_its_card_is_not_added(
    models: Path, file: Path, tmp_path: Path, changes: dict[str, object], problem: str
) -> None:
    changes = {"output__kind": "relative"} | changes
    changes |= {"output__min_m": None, "output__max_m": None}
    card = write_card(tmp_path / "c.json", **changes)
    with pytest.raises(ModelError, match=problem) as caught:
        add_model(file, card)
    assert ".depthcli-work" not in str(caught.value)  # which is gone when the message is read
    assert not models.exists() or not list(models.iterdir())


def test_a_fixed_graph_needs_its_size_in_the_card(models: Path, file: Path, tmp_path: Path) -> None:
    file.write_bytes(tiny_onnx(size=(24, 32)))
    with pytest.raises(ModelError):
        add_model(file, write_card(tmp_path / "c.json"))
    card = write_card(tmp_path / "c.json", input__width=32, input__height=24, input__dynamic=False)
    assert add_model(file, card).card.input.width == 32
    assert (models / "tiny").is_dir()
    file.write_bytes(tiny_onnx(size=(24, 32), card=json.dumps(card_with({"name": "inside"}))))
    with pytest.raises(ModelError):
        add_model(file)


@pytest.mark.parametrize("text", ["", "[]", "{", "null"])
def test_a_card_that_is_no_object_is_refused(models: Path, file: Path, text: str) -> None:
    card = file.with_name("c.json")
    card.write_text(text)
    with pytest.raises(ModelError):
        add_model(file, str(card))
    assert not models.exists()


def test_a_folder_that_cannot_be_made_is_an_error(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "wall").write_text("a file, not a folder")
    monkeypatch.setenv("DEPTHCLI_MODELS", str(tmp_path / "wall" / "models"))
    with pytest.raises(OutputError):
        add_model(file, write_card(tmp_path / "c.json"))


# In a process of its own: a fork of the tests' would wait for locks that their threads hold.
_KILLED = """
import os, sys
from pathlib import Path
from depthcli.io.storage.atomic import replace_folder
left = [None] * int(sys.argv[1])
def hook(event, _):
    if event == "os.rename":
        left.pop() if left else os._exit(9)
sys.addaudithook(hook)
replace_folder(Path(sys.argv[2]), Path(sys.argv[3]), "card.json")
"""


def test_a_killed_replacement_leaves_one_of_two(models: Path, file: Path, tmp_path: Path) -> None:
    card = write_card(tmp_path / "c.json")
    old = add_model(file, card)
    file.write_bytes(tiny_onnx(stride=2))
    hashes, code = set(), 9
    for count in range(99):
        folder = write_model(tmp_path / f"made-{count}", file.read_bytes(), file="model-new.onnx")
        (folder / "model.onnx").rename(folder / "model-new.onnx")
        command = [sys.executable, "-c", _KILLED, str(count), str(folder), str(models / "tiny")]
        code = subprocess.run(command, check=False, timeout=60).returncode
        if code != 9:  # it had no rename left at which it was to be killed
            break
        hashes.add(find_model("tiny").sha256)
    assert code == 0
    new = find_model("tiny").sha256
    assert hashes == {old.sha256, new}
    assert {path.name for path in (models / "tiny").iterdir()} == {"card.json", "model-new.onnx"}


def test_leftovers_of_a_killed_run_are_removed(models: Path, file: Path, tmp_path: Path) -> None:
    write_model(models / ".depthcli-work" / "tiny")
    add_model(file, write_card(tmp_path / "c.json"))
    assert [path.name for path in models.iterdir()] == ["tiny"]
    with workspace(models), pytest.raises(UsageError):
        remove_model("tiny")
    write_model(models / ".depthcli-work" / "tiny")
    remove_model("tiny")
    assert not list(models.iterdir())


@pytest.mark.parametrize(
    "other", ["last.ckpt", "wide.card.json", "runs/a.ckpt", ".env", ".git/HEAD"]
)
def test_a_folder_with_other_files_is_neither_replaced_nor_removed(
    models: Path, file: Path, tmp_path: Path, other: str
) -> None:
    card, extra = write_card(tmp_path / "c.json"), models / "tiny" / other
    extra.parent.mkdir(parents=True)
    extra.write_text("kept")
    with pytest.raises(UsageError):
        add_model(file, card)  # without a card, the folder is not in the list of models
    (write_model(models / "tiny") / "model.onnx").rename(models / "tiny/net.onnx")
    fields = json.loads((models / "tiny/card.json").read_text())
    (models / "tiny/card.json").write_text(json.dumps(fields | {"file": "net.onnx"}))
    with pytest.raises(UsageError):
        add_model(file, card, force=True)
    with pytest.raises(UsageError):
        remove_model("tiny")
    assert extra.read_text() == "kept"
    assert find_model("tiny").card.file == "net.onnx"
    extra.rename(tmp_path / "moved")
    if "/" in other:
        extra.parent.rmdir()
    remove_model("tiny")
    assert not list(models.iterdir())


def test_only_own_models_are_removed(models: Path, tmp_path: Path) -> None:
    write_model(models / "mine")
    for name in ("default", "nowhere", "../own/mine"):
        with pytest.raises(UsageError):
            remove_model(name)
    assert remove_model("mine") == models / "mine"
    assert not (models / "mine").exists()
    assert tmp_path.exists()


def test_a_model_of_one_file_is_removed_with_its_card(models: Path) -> None:
    models.mkdir()
    (models / "flat.onnx").write_bytes(tiny_onnx())
    write_card(models / "flat.card.json")
    (models / "other.txt").write_text("stays")
    remove_model("flat")
    assert [p.name for p in models.iterdir()] == ["other.txt"]
    (models / "flat.onnx").write_bytes(tiny_onnx(card=json.dumps(card_with({}))))
    (models / "flat").mkdir()
    (models / "flat" / "model.onnx").write_text("of another program")
    assert remove_model("flat") == models / "flat.onnx"
    assert sorted(p.name for p in models.iterdir()) == ["flat", "other.txt"]
    assert [p.name for p in (models / "flat").iterdir()] == ["model.onnx"]


def test_a_link_is_removed_and_never_replaced_or_followed(
    models: Path, file: Path, tmp_path: Path
) -> None:
    elsewhere = write_model(tmp_path / "elsewhere")
    models.mkdir()
    (models / "tiny").symlink_to(elsewhere)
    with pytest.raises(UsageError):
        add_model(file, write_card(tmp_path / "c.json"), force=True)
    assert (models / "tiny").is_symlink()
    remove_model("tiny")
    assert not list(models.iterdir())
    assert (elsewhere / "card.json").is_file()


def test_weights_in_a_second_file_have_a_checksum_too(models: Path, tmp_path: Path) -> None:
    path, options = tmp_path / "big.onnx", {"size_threshold": 0, "convert_attribute": True}
    model = onnx.load_from_string(tiny_onnx())
    onnx.save(model, path, save_as_external_data=True, location="big.onnx_data", **options)
    card = write_card(tmp_path / "c.json")
    added = add_model(path, card)
    (data,) = added.card.data
    assert data.file == "big.onnx_data"
    assert data.sha256 == hashlib.sha256((tmp_path / data.file).read_bytes()).hexdigest()
    ((name, outcome),) = verify_models(["tiny"])
    assert (name, outcome) == ("tiny", find_model("tiny"))
    add_model(path, card, force=True)  # all of its files are a model's
    stored = models / "tiny" / data.file
    stored.write_bytes(stored.read_bytes()[::-1])
    with pytest.raises(ModelError, match="another checksum"):
        find_model("tiny")
    remove_model("tiny")
    assert not list(models.iterdir())
    (tmp_path / data.file).unlink()
    with pytest.raises(ModelError, match=r"big\.onnx_data"):
        add_model(path, card)


@pytest.mark.parametrize("location", ["../secret", "/etc/hostname", "sub/w"])
@pytest.mark.usefixtures("models")
def test_weights_outside_the_folder_of_the_model_are_refused(location: str, tmp_path: Path) -> None:
    model = onnx.load_from_string(tiny_onnx())
    (tensor,) = model.graph.initializer
    external_data_helper.set_external_data(tensor, location)
    tensor.ClearField("raw_data")
    (tmp_path / "a.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(ModelError, match="not a file beside it"):
        add_model(tmp_path / "a.onnx", write_card(tmp_path / "c.json"))


def test_opset_and_ir_are_read_from_the_bytes() -> None:
    proto = onnx.load_from_string(tiny_onnx())
    proto.opset_import.append(onnx.helper.make_opsetid("com.microsoft", 1))
    proto.ir_version = 300  # two bytes
    assert onnx_facts(Path("x"), proto.SerializeToString())[:2] == (17, 300)
    with pytest.raises(ModelError):
        onnx_facts(Path("x"), b"")
