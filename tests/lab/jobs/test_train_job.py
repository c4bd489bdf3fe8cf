"""Training as a job: data, init weights, and what is told."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from helpers.rooms import EFFICIENT, write_rooms
from helpers.tiny import tiny_onnx, write_model

from depthcli.errors import CheckpointError, DatasetError, ModelError
from depthcli.inference.session import Session
from depthcli.lab.jobs.train import TrainRequest, train
from depthcli.lab.training.callbacks import Callback
from depthcli.lab.training.checkpoint import CHECKPOINT, Checkpoint
from depthcli.lab.training.init_weights import load_init_weights, weights_file
from depthcli.lab.training.networks.build import build_generator
from depthcli.lab.training.provenance import DataProvenance
from depthcli.lab.training.settings import resolve_config
from depthcli.models.catalog import find_model


def _request(folder: Path, **others: float) -> TrainRequest:
    return TrainRequest(
        EFFICIENT, folder / "data", folder / "run", accelerator="cpu", threads=1, **others
    )


@pytest.mark.parametrize(
    "changed",
    [{"units_per_metre": 256.0}, {"split": "official"}],
    ids=["unit is known", "no pair of the split"],
)
def test_settings_of_the_data_are_those_of_the_run(tmp_path: Path, changed: dict[str, Any]) -> None:
    index = write_rooms(tmp_path / "data") / "index.csv"
    index.write_text(index.read_text().replace(",train", ",test"))
    request = _request(tmp_path)
    config = replace(request.config, data=replace(request.config.data, **changed))
    with pytest.raises(DatasetError):
        train(replace(request, config=config), Callback())
    assert not request.out.exists()


def test_an_unknown_start_model_is_told_before_the_data_set_is_opened(tmp_path: Path) -> None:
    request = replace(_request(tmp_path), init_weights=(Path("nope"),))
    with pytest.raises(ModelError):
        train(request, Callback())


CAMERAS = "id,focal_px\n" + "".join(f"room{i:04d},60\n" for i in range(6))


@pytest.fixture
def request_of(tmp_path: Path) -> TrainRequest:
    """Six rooms under names of their own, of which one is held out, after one step."""
    mine, run = write_rooms(tmp_path / "mine", prefix="room"), tmp_path / "run"
    request = TrainRequest(EFFICIENT, mine, run, accelerator="cpu", threads=1, minutes=0)
    train(request, Callback())
    assert Checkpoint.load(run / CHECKPOINT).provenance.held_out_ids == ("room0002",)
    return request


def _add_camera(folder: Path) -> None:
    (folder / "cameras.csv").write_text(CAMERAS)


def _add_held_out(folder: Path) -> None:
    for part in ("rgb", "depth"):
        shutil.copy(folder / part / "room0002.png", folder / part / "room0006.png")
    with (folder / "index.csv").open("a") as index:
        index.write("room0006,den_1,train\n")


def _paint(folder: Path) -> None:
    file = str(next(folder.glob("rgb/*0000.png")))
    cv2.imwrite(file, cv2.imread(file) // 2)


@pytest.mark.parametrize("change", [_add_camera, _add_held_out, _paint])
def test_changed_data_are_refused(request_of: TrainRequest, change: Callable[[Path], None]) -> None:
    change(request_of.data)
    with pytest.raises(CheckpointError):
        train(request_of, Callback())


def test_other_focal_lengths_are_refused(request_of: TrainRequest) -> None:
    _add_camera(request_of.data)
    request = replace(request_of, out=request_of.out.with_name("scaled"))
    train(request, Callback())
    (request.data / "cameras.csv").write_text(CAMERAS.replace(",60", ",80"))
    with pytest.raises(CheckpointError):
        train(request, Callback())


def test_folder_of_the_data_may_have_moved(request_of: TrainRequest) -> None:
    moved = replace(request_of, data=request_of.data.rename(request_of.data.with_name("moved")))
    assert train(moved, Callback()).state.step == 2


def test_a_bundled_model_gives_the_weights_of_its_float_model() -> None:
    for name in (Path("default"), Path("fast"), Path("float"), find_model("fast").path):
        assert weights_file(name) == find_model("float").path


def test_the_preset_finetune_starts_where_the_bundled_model_is() -> None:
    config, model = resolve_config("proposed", "finetune"), find_model("float")
    generator = build_generator(config.generator).eval()
    load_init_weights(generator, [weights_file(Path("default"))], DataProvenance())
    spec = model.card.input
    assert (config.data.width, config.data.height) == (spec.width, spec.height)
    size = (1, 1, spec.height, spec.width)
    gray = torch.rand(size, generator=torch.Generator().manual_seed(0)) * 2 - 1
    with torch.no_grad():
        started = generator(gray)
    exported = Session(model, provider="cpu", threads=1).run(gray.numpy())
    np.testing.assert_allclose(started.numpy().squeeze(), exported.squeeze(), atol=2e-3)


def test_a_model_without_a_card_inside_has_the_one_beside(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "other")
    model = weights_file(folder)
    assert model == folder / "model.onnx"
    assert find_model(model).card == find_model(folder).card
    model.write_bytes(tiny_onnx(channels=3))
    with pytest.raises(ModelError):
        find_model(model)
    model.rename(folder / "b.onnx")
    with pytest.raises(ModelError):
        find_model(folder / "b.onnx")


def test_a_checkpoint_is_taken_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "last.ckpt").touch()
    assert weights_file(tmp_path / "last.ckpt") == tmp_path / "last.ckpt"
    with pytest.raises(CheckpointError):
        weights_file(tmp_path / "lost.ckpt")
