"""Encoders of timm: training, export and parity from random weights, and pretrained ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.supervised_runs import SUPERVISED, train_steps

from depthcli.errors import CheckpointError, UsageError
from depthcli.lab.export.graph import build_graph, check_parity
from depthcli.lab.export.onnx import ExportOptions, export_checkpoint
from depthcli.lab.training.checkpoint import CHECKPOINT, load_generator
from depthcli.lab.training.config import GeneratorConfig
from depthcli.lab.training.networks.encoder import EncoderGenerator, SamePaddedConv2d, timm_features
from depthcli.lab.training.settings import apply_overrides

FAMILIES = ("test_efficientnet", "test_convnext", "test_resnet")
"""Tiny ones of timm, of 0.1 to 0.4 million weights; the second has no stride of 2."""

DECODER = (8, 8, 8, 8)
FIRST = GeneratorConfig(name="encoder", encoder=FAMILIES[0], decoder=DECODER, norm="decoder")


def _generator(
    name: str = FAMILIES[0], norm: str = "decoder", channels: int = 1
) -> EncoderGenerator:
    torch.manual_seed(0)
    config = GeneratorConfig("encoder", encoder=name, decoder=DECODER, norm=norm)
    network = EncoderGenerator(config, channels)
    torch.nn.init.normal_(network.head.weight)
    return network.eval()


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """A file of weights under other names, with the classifier's behind them."""
    torch.manual_seed(1)
    state = timm_features(FAMILIES[0], 3).state_dict()
    for name, tensor in state.items():
        if name.endswith("running_var"):
            tensor.uniform_(0.5, 2)
        elif name.endswith("running_mean"):
            tensor.normal_(0, 0.1)
    file = tmp_path / "weights.pth"
    named = {
        f"_old{i}.{name.rpartition('.')[2]}": value for i, (name, value) in enumerate(state.items())
    }
    torch.save(named | {"_fc.weight": torch.ones(10, 64)}, file)
    return file


@pytest.mark.parametrize("name", FAMILIES)
def test_any_family_trains_and_exports_with_parity(name: str, tmp_path: Path) -> None:
    generator = GeneratorConfig(name="encoder", encoder=name, decoder=DECODER)
    data = replace(SUPERVISED.data, width=64, height=64)
    train_steps(replace(SUPERVISED, generator=generator, data=data), tmp_path)
    exported = export_checkpoint(tmp_path / CHECKPOINT, tmp_path / "m.onnx", ExportOptions())
    assert exported.parity.max_abs < 1e-3
    assert len(exported.parity.cases) == 5
    assert exported.card.training["config"]["generator"]["encoder"] == name


@pytest.mark.parametrize("norm", ["batch", "decoder"])
def test_pretrained_weights_are_read_by_order_for_gray_input(norm: str, weights: Path) -> None:
    network = _generator(norm=norm)
    network.load_encoder(weights)
    reference = timm_features(FAMILIES[0], 3).eval()
    values = list(torch.load(weights).values())
    reference.load_state_dict(dict(zip(reference.state_dict(), values, strict=False)))
    gray = torch.rand(2, 1, 64, 64) * 2 - 1
    # What the mean of ImageNet shifts is left to training: it is 0 in the middle of the range.
    std = torch.tensor(reference.default_cfg["std"]).view(1, 3, 1, 1)
    expected = reference(gray * 0.5 / std)
    with torch.no_grad():
        for features, map_ in zip(network.encoder(gray), expected, strict=True):
            np.testing.assert_allclose(features.numpy(), map_.detach().numpy(), atol=1e-4)


def test_weights_of_another_encoder_are_refused(weights: Path, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError):
        _generator("test_resnet").load_encoder(weights)
    few = dict(list(torch.load(weights).items())[:5])
    torch.save(few, tmp_path / "few.pth")
    with pytest.raises(CheckpointError):
        _generator().load_encoder(tmp_path / "few.pth")
    (tmp_path / "text.pth").write_text("no weights")
    with pytest.raises(CheckpointError):
        _generator().load_encoder(tmp_path / "text.pth")


def test_run_starts_from_an_encoder_and_resumes_without_it(weights: Path, tmp_path: Path) -> None:
    optim = replace(SUPERVISED.optim, encoder_rate=0.0)
    config = replace(SUPERVISED, generator=FIRST, optim=optim)
    train_steps(config, tmp_path / "run", init_weights=weights)
    expected = _generator()
    expected.load_encoder(weights)
    trained, saved = load_generator(tmp_path / "run" / CHECKPOINT)
    assert saved.provenance.encoder_weights.startswith("weights.pth ")
    for name, value in expected.encoder.state_dict().items():
        assert torch.equal(trained.state_dict()[f"encoder.{name}"], value)  # its rate is 0
    assert train_steps(config, tmp_path / "run").step == 3


def test_exported_network_starts_another_without_norm(weights: Path, tmp_path: Path) -> None:
    config = replace(SUPERVISED, generator=FIRST)
    train_steps(config, tmp_path / "run", init_weights=weights)
    exported = export_checkpoint(
        tmp_path / "run" / CHECKPOINT, tmp_path / "m.onnx", ExportOptions()
    )
    assert exported.card.training["encoder_weights"].startswith("weights.pth ")
    bare = replace(config, generator=replace(FIRST, norm="none"))
    assert train_steps(bare, tmp_path / "next", init_weights=exported.path).step == 2
    _, saved = load_generator(tmp_path / "next" / CHECKPOINT)
    assert saved.provenance.encoder_weights == exported.card.training["encoder_weights"]


@pytest.mark.parametrize(("size", "bias"), [(3, True), (5, False)])
def test_same_padding_is_part_of_the_exported_convolution(*, size: int, bias: bool) -> None:
    timm_features(FAMILIES[0], 1)  # imports timm
    from timm.layers.padding import pad_same  # noqa: PLC0415

    torch.manual_seed(0)
    conv = torch.nn.Conv2d(1, 4, size, 2, bias=bias)
    x = torch.rand(1, 1, 64, 96)
    reference = conv(pad_same(x, (size, size), (2, 2)))
    conv.__class__ = SamePaddedConv2d
    torch.testing.assert_close(conv(x), reference)
    model = build_graph(conv)
    assert [node.op_type for node in model.graph.node] == ["Conv"]
    check_parity(conv, model.SerializeToString(), ((1, 64, 96), (2, 33, 47)))


@pytest.mark.parametrize("name", ["test_vit", "no_such_model"])
def test_encoder_without_a_pyramid_is_refused(name: str) -> None:
    with pytest.raises(UsageError):
        _generator(name)


@pytest.mark.parametrize(
    "settings",
    [
        ["generator.name=encoder"],
        ["generator.name=efficient", "generator.encoder=test_resnet"],
        ["generator.name=encoder", "generator.encoder=test_resnet", "generator.decoder=[1]"],
        ["generator.name=efficient", "data.colour=rgb"],
        ["data.colour=rgb", "generator.residual=input"],
    ],
)
def test_encoder_and_colour_are_for_the_network_of_that_name(settings: list[str]) -> None:
    with pytest.raises(UsageError):
        apply_overrides(SUPERVISED, [], settings)
