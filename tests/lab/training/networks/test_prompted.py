"""The network that follows known depth: where it begins, what it keeps, and a run of it."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.rooms import rooms
from helpers.runs import same
from helpers.supervised_runs import SUPERVISED, train_steps
from helpers.tiny import load
from torch import Tensor, nn

from depthcli.core.types import Frame
from depthcli.errors import UsageError
from depthcli.lab.export.onnx import ExportOptions, export_checkpoint
from depthcli.lab.training.checkpoint import CHECKPOINT, Checkpoint, load_generator
from depthcli.lab.training.config import GeneratorConfig, TrainConfig
from depthcli.lab.training.methods.prompted import nearer_far_away
from depthcli.lab.training.networks.build import build_generator
from depthcli.lab.training.networks.efficient import EfficientGenerator
from depthcli.lab.training.networks.encoder import EncoderGenerator
from depthcli.lab.training.networks.points import GAIN, Points, robust_mean
from depthcli.lab.training.networks.prompted import PromptedGenerator, coded_prompt
from depthcli.lab.training.settings import resolve_config

WIDTHS = (8, 8, 8, 8)


def _base(kind: str = "efficient") -> EfficientGenerator | EncoderGenerator:
    torch.manual_seed(0)
    encoder = "test_resnet" if kind == "encoder" else (8,) * 5
    config = GeneratorConfig(kind, encoder=encoder, decoder=(8,) * 4, depths=(1,) * 4, dropout=0.1)
    network: EfficientGenerator | EncoderGenerator = build_generator(config)
    nn.init.normal_(network.head.weight)
    return network


def _known(height: int = 36, width: int = 64) -> tuple[Tensor, Tensor, Tensor]:
    random = torch.Generator().manual_seed(1)
    image, prompt, chosen = torch.rand(3, 2, 1, height, width, generator=random)
    mask = (chosen < 0.05).float()
    return image, prompt * mask, mask


@pytest.mark.parametrize("kind", ["efficient", "encoder"])
def test_without_points_it_is_the_plain_network(kind: str) -> None:
    base = _base(kind)
    network = PromptedGenerator(base, WIDTHS)
    for weight in network.correction.parameters():
        nn.init.normal_(weight)
    image, prompt, mask = _known()
    plain = base.eval()(image)
    network.train()
    mask[0] = 0
    assert torch.equal(network(image), plain)
    enlarged = nn.functional.interpolate(plain, scale_factor=2, mode="bilinear")
    output = network(image, prompt, mask)
    torch.testing.assert_close(output[0], enlarged[0])
    assert not torch.allclose(output[1], enlarged[1])


def test_depth_of_the_points_times_a_number_is_depth_times_it() -> None:
    network = PromptedGenerator(_base(), WIDTHS)
    image, prompt, mask = _known()
    output = network(image, prompt, mask)
    moved = network(image, (prompt + 3) * mask, mask)
    assert float((moved - output - 3).detach().abs().max()) < 1e-4


def test_starts_as_an_interpolation_that_leaves_wrong_points_out() -> None:
    network = PromptedGenerator(_base().eval(), WIDTHS)
    image = torch.zeros(1, 1, 96, 128)
    raw = network(image)
    across = torch.linspace(-0.3, 0.3, 128).expand(1, 1, 96, 128)
    truth = nn.functional.interpolate(raw, (96, 128), mode="bilinear") + across
    random = torch.Generator().manual_seed(0)
    mask = (torch.rand(1, 1, 96, 128, generator=random) < 0.05).float()
    wrong = (torch.rand(1, 1, 96, 128, generator=random) < 0.1) * 1.5
    errors = [
        float((network(image, (truth + extra) * mask, mask) - truth).detach().abs().mean())
        for extra in (0 * wrong, wrong)
    ]
    assert errors[0] < 0.02
    assert errors[1] < 0.04


def test_farthest_known_depth_is_that_of_a_cell_of_stride_16() -> None:
    random = torch.Generator().manual_seed(2)
    predicted, wide = torch.rand(2, 2, 1, 16, 24, generator=random)
    prompt, mask = torch.rand(2, 2, 4, 16, 24, generator=random)
    mask = (mask < 0.1).float()
    points = Points(prompt, mask, predicted.expand(2, 4, 16, 24))
    farthest = points.beyond_farthest(wide)
    for i in range(2):
        means = []
        for top in (0, 8):
            for left in (0, 8, 16):
                at = i, ..., slice(top, top + 8), slice(left, left + 8)
                error = (prompt - predicted)[at] * mask[at]
                share = mask[at].sum(0)
                mean = error.sum(0) / share.clamp(min=1) + wide[at][0]
                means.append(float((mean * share).sum() / share.sum()))
        expected = wide[i] - max(means) + points.centre[i]
        torch.testing.assert_close(farthest[i], GAIN * expected, rtol=1e-4, atol=1e-3)


def test_only_far_depth_of_half_of_the_views_is_made_nearer() -> None:
    torch.manual_seed(0)
    raw = torch.linspace(-1, 1, 101).expand(400, 1, 1, 101)
    less = raw - nearer_far_away(raw)
    assert 0.4 < (less.amax((1, 2, 3)) > 0).float().mean() < 0.6
    assert (less.diff(dim=3) >= -1e-6).all()
    assert less.min() > -1e-6
    assert (less <= raw + 1 + 1e-6).all()


def test_robust_mean_is_near_most_values() -> None:
    values = torch.tensor([0.5, 0.52, 0.48, 0.5, 1.5, 9.0]).view(1, 1, 2, 3)
    mask = torch.tensor([1.0, 1, 1, 1, 1, 0]).view(1, 1, 2, 3)
    assert float(robust_mean(values, mask)) == pytest.approx(0.5, abs=0.03)
    assert float(robust_mean(values, 0 * mask)) == 0


def test_coded_prompt_is_the_inverse_of_decoding() -> None:
    codec = SUPERVISED.output.codec
    depth_m = torch.tensor([0.0, 0.5, 20.0]).view(1, 1, 1, 3)
    coded, mask = coded_prompt(depth_m, codec)
    assert mask.flatten().tolist() == [0, 1, 1]
    decoded = codec.decode(coded.numpy()).ravel()[1:]
    np.testing.assert_allclose(decoded, [0.5, 20], rtol=1e-5)


def _plain_run(folder: Path, config: TrainConfig = SUPERVISED) -> Path:
    train_steps(config, folder)
    return folder / CHECKPOINT


def _config(init: Path, *settings: str) -> TrainConfig:
    usual = ("generator.prompt=[8,8,8,8]", "precision=32-true", "optim.batch_size=4")
    small = ("validate_every=1", "data.holdout_every=4", "data.holdout_offset=1", "data.aspects=[]")
    return resolve_config("prompted", settings=(*usual, *small, *settings), init=init)


def test_run_trains_the_added_layers_alone_resumes_and_exports(tmp_path: Path) -> None:
    """Of an encoder for colour; the shipped network is rounded in the tests of int8."""
    encoder = GeneratorConfig(name="encoder", encoder="test_resnet", decoder=(8,) * 4)
    colour = replace(SUPERVISED, generator=encoder, data=replace(SUPERVISED.data, colour="rgb"))
    init = _plain_run(tmp_path / "plain", colour)
    config = _config(init)
    assert config.generator.encoder == encoder.encoder
    assert (config.data.width, config.data.height) == (64, 32)
    for folder, steps, source in (("parts", 2, init), ("parts", 2, None), ("whole", 4, init)):
        done = train_steps(config, tmp_path / folder, source, steps=steps)
    assert done.step == 4
    whole, parts = (Checkpoint.load(tmp_path / run / CHECKPOINT) for run in ("whole", "parts"))
    assert same(whole.method, parts.method)
    generator, saved = load_generator(tmp_path / "parts" / CHECKPOINT)
    assert isinstance(generator, PromptedGenerator)
    assert same(dict(generator.base.state_dict()), dict(load_generator(init)[0].state_dict()))
    assert any(weight.any() for weight in generator.correction.enlarging.head.parameters())
    assert np.isfinite(saved.state.scores["abs_rel"])
    exported = export_checkpoint(
        tmp_path / "parts" / CHECKPOINT, tmp_path / "m.onnx", ExportOptions()
    )
    assert exported.card.input.prompt
    assert exported.parity.max_abs < 1e-3
    depth = load(tmp_path / "m.onnx", provider="cpu").predict(Frame(rooms().image(0))).depth
    assert depth.valid.all()


def test_a_new_run_needs_a_network_whose_settings_it_takes(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="trained network"):
        resolve_config("prompted", folder=tmp_path)
    init = _plain_run(tmp_path / "plain")
    exported = export_checkpoint(init, tmp_path / "m.onnx", ExportOptions())
    config = _config(exported.path)
    assert config.generator.norm == "none"
    assert asdict(config.output) == asdict(SUPERVISED.output)
    assert train_steps(config, tmp_path / "run", init_weights=exported.path).step == 2


@pytest.mark.parametrize(
    "setting", ["generator.name=resnet", "output.coding=linear", "generator.prompt=[]"]
)
def test_networks_without_a_decoder_and_other_codings_are_refused(setting: str) -> None:
    with pytest.raises(UsageError):
        resolve_config("prompted", settings=(setting,))
    with pytest.raises(UsageError):
        resolve_config("proposed", settings=("generator.prompt=[8,8,8,8]",))
