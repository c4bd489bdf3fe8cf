"""What every registered method must do: step, save, resume, and give a generator."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.rooms import PAPER, room_data
from helpers.tiny_methods import tiny
from lightning_fabric import Fabric

from depthcli.errors import UsageError
from depthcli.training.callbacks import Callback
from depthcli.training.checkpoint import CHECKPOINT, Checkpoint, load_generator
from depthcli.training.config import TrainConfig
from depthcli.training.methods.registry import build_method
from depthcli.training.methods.table import METHODS
from depthcli.training.run import fit


def _two_steps(config: TrainConfig, folder: Path, steps: int = 2) -> int:
    fabric = Fabric(accelerator="cpu", devices=1)
    return fit(config, room_data(), folder, fabric, Callback(), max_steps=steps).step


@pytest.mark.parametrize("name", METHODS)
def test_method_steps_saves_and_resumes(tmp_path: Path, name: str) -> None:
    config = tiny(name)
    assert _two_steps(config, tmp_path) == 2
    first = Checkpoint.load(tmp_path / CHECKPOINT)
    fresh = build_method(config).state_dict()
    assert first.method.keys() == fresh.keys()
    assert _two_steps(config, tmp_path) == 4
    second = Checkpoint.load(tmp_path / CHECKPOINT)
    moved = {n for n in fresh if not torch.equal(first.method[n], second.method[n])}
    phases = {n.partition(".")[0] for n in fresh}
    assert {n.partition(".")[0] for n in moved} == phases  # every network learns


@pytest.mark.parametrize("name", METHODS)
def test_method_resumes_bit_exactly(tmp_path: Path, name: str) -> None:
    config = tiny(name)
    _two_steps(config, tmp_path / "broken")
    _two_steps(config, tmp_path / "broken")
    _two_steps(config, tmp_path / "whole", steps=4)
    broken, whole = (Checkpoint.load(tmp_path / run / CHECKPOINT) for run in ("broken", "whole"))
    for key, weights in whole.method.items():
        assert torch.equal(weights, broken.method[key]), key
    for key, images in whole.extra.items():
        assert all(map(torch.equal, images, broken.extra[key])), key
    assert torch.equal(whole.rng, broken.rng)


@pytest.mark.parametrize("name", METHODS)
def test_methods_generator_maps_a_picture_to_depth(tmp_path: Path, name: str) -> None:
    config = tiny(name)
    _two_steps(config, tmp_path)
    generator, checkpoint = load_generator(tmp_path / CHECKPOINT)
    method = build_method(config)
    method.load_state_dict(checkpoint.method)
    pictures = torch.rand(2, 1, 32, 48) * 2 - 1
    with torch.no_grad():
        raw = generator(pictures).numpy()
        forward = method.generator.eval()(pictures).numpy()
    np.testing.assert_array_equal(raw, forward)  # G, never F, which some methods have beside it
    assert raw.shape == (2, 1, 32, 48)
    depth_m = checkpoint.config.output.codec.decode(raw)
    assert bool(np.all((depth_m >= 0) & (depth_m <= 10)))


@pytest.mark.parametrize("name", METHODS)
def test_phases_own_every_weight_once(name: str) -> None:
    method = build_method(tiny(name))
    owned = [
        id(w) for phase in method.phases for net in method.networks(phase) for w in net.parameters()
    ]
    assert sorted(owned) == sorted(id(w) for w in method.parameters())


def test_unknown_method_names_the_known() -> None:
    with pytest.raises(UsageError):
        build_method(replace(PAPER, method="pix2pix"))
