"""What a training run can start from: bundled models by name, files, checkpoints."""

from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.tiny import tiny_onnx, write_model

from depthcli.errors import CheckpointError, ModelError
from depthcli.inference.session import Session
from depthcli.models.catalog import find_model
from depthcli.training.init_weights import load_init_weights, weights_file
from depthcli.training.networks.build import build_generator
from depthcli.training.provenance import DataProvenance
from depthcli.training.settings import resolve_config


@pytest.mark.parametrize("name", ["default", "fast", "float"])
def test_a_bundled_model_gives_the_weights_of_its_float_model(name: str) -> None:
    assert weights_file(Path(name)) == find_model("float").path


def test_a_model_s_file_stands_for_its_float_model_too() -> None:
    assert weights_file(find_model("fast").path) == find_model("float").path


def test_the_preset_finetune_starts_where_the_bundled_model_is() -> None:
    config, model = resolve_config("proposed", "finetune"), find_model("float")
    generator = build_generator(config.generator).eval()
    load_init_weights(generator, [weights_file(Path("default"))], DataProvenance())
    seen = model.card.input
    assert (config.data.width, config.data.height) == (seen.width, seen.height)
    size = (1, 1, seen.height, seen.width)
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


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(ModelError):
        weights_file(Path("nope"))
