"""Masked pictures: what is hidden, what is learned, and that other methods start from it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from helpers.rooms import room_data
from helpers.tiny_methods import SIZES, batch
from lightning_fabric import Fabric

from depthcli.core.types import DepthMap
from depthcli.datasets.training_data import open_training_data
from depthcli.errors import CheckpointError, DatasetError
from depthcli.export.onnx import ExportOptions, export_checkpoint
from depthcli.io.formats.png16 import Png16Writer
from depthcli.training.callbacks import Callback
from depthcli.training.checkpoint import CHECKPOINT, Checkpoint, load_generator
from depthcli.training.config import TrainConfig, updated
from depthcli.training.data import TrainingBatch
from depthcli.training.loop import Limits, fit
from depthcli.training.methods.masked import Masked, hidden_blocks
from depthcli.training.methods.registry import build_method, default_config

SMALL: dict[str, Any] = SIZES | {
    "precision": "32-true",
    "optim": {"epochs_decay": 2, "batch_size": 2, "warmup_steps": 1},
}
NETWORKS = {
    "efficient": {"encoder": [8, 8, 8, 8, 8], "decoder": [8, 8, 8, 8], "depths": [1, 1, 1, 1]},
    "resnet": {"width": 8, "blocks": 2},
}


def _small(network: str = "efficient") -> TrainConfig:
    generator = {"name": network} | NETWORKS[network]
    return updated(default_config("masked"), SMALL | {"generator": generator})


def _two() -> TrainingBatch:
    """Two pictures: batch norm needs more than one of this size."""
    first, second = batch(0), batch(1)
    return TrainingBatch(
        torch.cat([first.network_input, second.network_input]),
        torch.cat([first.depth_m, second.depth_m]),
    )


def _fit(config: TrainConfig, folder: Path, **more: Any) -> Checkpoint:
    fabric = Fabric(accelerator="cpu", devices=1)
    fit(config, more.pop("data", room_data()), folder, fabric, Callback(), **more)
    return Checkpoint.load(folder / CHECKPOINT)


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """Six pictures, some in a subfolder, without any depth."""
    random = np.random.default_rng(0)
    for name in ("a/0.png", "a/1.jpg", "2.png", "3.png", "4.png", "5.png"):
        file = tmp_path / "pictures" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(file), random.integers(0, 255, (48, 64, 3), np.uint8))
    return tmp_path / "pictures"


def test_blocks_are_hidden_with_the_given_probability() -> None:
    torch.manual_seed(0)
    picture = torch.zeros(64, 1, 36, 48)
    hidden = hidden_blocks(picture, 0.55)
    assert hidden.shape == picture.shape
    blocks = hidden.unfold(2, 4, 4).unfold(3, 4, 4).flatten(4)  # 4 px: a twelfth of 48
    assert torch.equal(blocks.all(4), blocks.any(4))
    assert blocks.all(4).float().mean().item() == pytest.approx(0.55, abs=0.02)
    assert not hidden_blocks(picture, 0).any()
    assert hidden_blocks(torch.zeros(1, 1, 35, 47), 1).all()


def test_the_network_does_not_see_what_is_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    method = build_method(_small())
    assert isinstance(method, Masked)
    seen: list[torch.Tensor] = []
    features = method.generator.last_features
    monkeypatch.setattr(method.generator, "last_features", lambda x: seen.append(x) or features(x))
    given = _two()
    torch.manual_seed(5)
    method(given, "generator")
    torch.manual_seed(5)
    hidden = hidden_blocks(given.network_input, 0.55)
    assert torch.equal(seen[0], torch.where(hidden, torch.zeros(()), given.network_input))


@pytest.mark.parametrize("network", NETWORKS)
def test_everything_but_the_last_layer_learns(tmp_path: Path, network: str) -> None:
    config = _small(network)
    fresh = build_method(config).state_dict()
    learned = _fit(config, tmp_path, limits=Limits(steps=3)).method
    still = {name for name in fresh if torch.equal(fresh[name], learned[name])}
    kept = {name for name in still if "num_batches" not in name}
    assert {name.split(".")[1] for name in kept} == {"head"}
    assert any(name.startswith("reconstruct.") for name in fresh.keys() - kept)


def test_it_learns_what_is_hidden() -> None:
    """Slopes, which the blocks around a hidden one tell."""
    method = build_method(_small())
    slope = torch.linspace(-1, 1, 32).expand(1, 1, 32, 32)
    slopes = TrainingBatch(torch.cat([slope, -slope]), torch.ones(2, 1, 32, 32))
    optimizer = torch.optim.Adam(method.parameters(), 1e-2)
    losses = []
    for _ in range(150):
        loss = method(slopes, "generator")["reconstruction"]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert np.mean(losses[-10:]) < losses[0] / 4


def test_another_method_starts_from_it(tmp_path: Path) -> None:
    _fit(_small(), tmp_path / "masked")
    last = tmp_path / "masked" / CHECKPOINT
    loss = replace(_small().loss, reconstruction=0.0, l1=1.0)
    config = replace(_small(), method="proposed", loss=loss)
    begun = _fit(config, tmp_path / "run", init_weights=[last], limits=Limits(steps=1))
    assert begun.provenance.init_weights.startswith("last.ckpt ")
    learned = load_generator(last)[0].state_dict()["stem.0.weight"]
    fresh = build_method(config).generator.state_dict()["stem.0.weight"]
    now = begun.method["generator.stem.0.weight"]
    assert (now - learned).abs().max() < (now - fresh).abs().max() / 2


def test_pictures_without_depth_suffice(pictures: Path, tmp_path: Path) -> None:
    data = open_training_data(pictures, paired=True, depth=False)
    assert data.title == "own pictures (pictures)"
    assert data.dataset.ids == ("2", "3", "4", "5", "a/0", "a/1")
    saved = _fit(_small(), tmp_path / "run", data=data)
    assert saved.provenance.train_ids == data.dataset.ids
    assert saved.state.scores == {}
    with pytest.raises(DatasetError):
        open_training_data(pictures, paired=True)


def test_the_pictures_of_pairs_are_those_in_rgb(pictures: Path, tmp_path: Path) -> None:
    (tmp_path / "pairs").mkdir()
    pictures.rename(tmp_path / "pairs" / "rgb")
    (tmp_path / "pairs" / "depth").mkdir()
    cv2.imwrite(str(tmp_path / "pairs" / "depth" / "x.png"), np.ones((4, 4), np.uint16))
    assert len(open_training_data(tmp_path / "pairs", paired=True, depth=False).dataset) == 6


def test_outputs_of_depthcli_are_no_photographs(pictures: Path) -> None:
    write = Png16Writer().write
    write(DepthMap(np.ones((4, 4), np.float32)), pictures / "x.depth.png")
    assert len(open_training_data(pictures, paired=True, depth=False).dataset) == 6
    for path in pictures.rglob("*"):
        if path.is_file() and path.name != "x.depth.png":
            path.unlink()
    with pytest.raises(DatasetError):
        open_training_data(pictures, paired=True, depth=False)


def test_a_folder_without_pictures_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError):
        open_training_data(tmp_path, paired=True, depth=False)


def test_held_out_scenes_are_neither_seen_nor_scored(tmp_path: Path) -> None:
    saved = _fit(_small(), tmp_path, limits=Limits(steps=1))
    assert saved.provenance.held_out_ids
    assert not set(saved.provenance.held_out_ids) & set(saved.provenance.train_ids)
    assert not (tmp_path / "samples").exists()


def test_it_is_not_exported(tmp_path: Path) -> None:
    _fit(_small(), tmp_path, limits=Limits(steps=1))
    with pytest.raises(CheckpointError, match="predicts no depth"):
        export_checkpoint(tmp_path / CHECKPOINT, tmp_path / "x.onnx", ExportOptions())
    assert not (tmp_path / "x.onnx").exists()
