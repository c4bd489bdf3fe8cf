"""Init weights for a deeper network, or for one with a narrower decoder."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
import torch
from helpers.supervised_runs import BARE, SUPERVISED, train_two_steps

from depthcli.errors import CheckpointError
from depthcli.training.checkpoint import CHECKPOINT, load_generator
from depthcli.training.initial_weights import load_init_weights, resized_weights
from depthcli.training.networks.build import build_generator

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

    from depthcli.training.config import GeneratorConfig
    from depthcli.training.networks.efficient import EfficientGenerator

WIDE = replace(BARE.generator, decoder=(8, 8, 6, 4))
NARROW = replace(WIDE, decoder=(8, 6, 4, 2))


def _gray() -> Tensor:
    return torch.rand(3, 1, 32, 48, generator=torch.Generator().manual_seed(1)) * 2 - 1


def _random(config: GeneratorConfig, seed: int = 0) -> EfficientGenerator:
    """With random weights in the last layer, too, which is built as zeros."""
    torch.manual_seed(seed)
    generator = build_generator(config)
    torch.nn.init.normal_(generator.head.weight)
    return generator.eval()


@pytest.mark.parametrize("norm", ["batch", "none"])
def test_a_deeper_network_starts_with_the_same_depth(norm: str) -> None:
    shallow = replace(WIDE, norm=norm, depths=(1, 2, 1, 1))
    before, deeper = _random(shallow), _random(replace(shallow, depths=(2, 2, 3, 1)), seed=1)
    weights = resized_weights(deeper, before.state_dict(), pytest.fail)
    assert set(weights) == set(deeper.state_dict())
    deeper.load_state_dict(weights)
    assert torch.equal(deeper(_gray()), before(_gray()))
    loss = deeper(_gray()).square().mean()
    loss.backward()
    for stage, block in ((0, 1), (2, 1), (2, 2)):  # they can learn: the gradient is not zero
        assert deeper.stages[stage][block].body[1][0].weight.grad.abs().max() > 0


@pytest.mark.parametrize("norm", ["batch", "none"])
def test_a_narrower_decoder_loses_no_channel_that_is_used(norm: str) -> None:
    config = replace(WIDE, norm=norm)
    wide, narrow = _random(config), _random(replace(NARROW, norm=norm), seed=1)
    unused = {1: [0, 7], 2: [2, 3], 3: [0, 1]}
    for index, channels in unused.items():
        last = wide.fusions[index][1 if norm == "batch" else 0]
        with torch.no_grad():
            last.weight[channels] = 0
            last.bias[channels] = -1  # zero after ReLU, on every picture
    narrow.load_state_dict(resized_weights(narrow, wide.state_dict(), _gray))
    torch.testing.assert_close(narrow(_gray()), wide(_gray()))


def test_channels_that_nothing_reads_go_before_those_that_are_read() -> None:
    wide, narrow = _random(WIDE), _random(replace(WIDE, decoder=(8, 8, 6, 3)), seed=1)
    with torch.no_grad():
        wide.fusions[3][0].bias += 10  # all are active
        wide.head.weight[:, 1] = 0
    narrow.load_state_dict(resized_weights(narrow, wide.state_dict(), _gray))
    torch.testing.assert_close(narrow(_gray()), wide(_gray()))


def test_of_several_runs_the_mean_is_narrowed(tmp_path: Path) -> None:
    config = replace(BARE, generator=WIDE)
    files = [tmp_path / name / CHECKPOINT for name in "ab"]
    for seed, file in enumerate(files):
        train_two_steps(replace(config, seed=seed), file.parent)
    narrow, mean = build_generator(NARROW), build_generator(WIDE)
    load_init_weights(narrow, files, _gray)
    load_init_weights(mean, files, pytest.fail)
    expected = resized_weights(narrow, mean.state_dict(), _gray)
    for name, weights in narrow.state_dict().items():
        assert torch.equal(weights, expected[name])


def test_a_run_starts_from_a_shallower_and_wider_one(tmp_path: Path) -> None:
    first = replace(BARE, generator=WIDE)
    train_two_steps(first, tmp_path / "first")
    second = replace(BARE, generator=replace(NARROW, depths=(2, 1, 1, 2)))
    state = train_two_steps(second, tmp_path / "second", tmp_path / "first" / CHECKPOINT)
    assert state.start.startswith("last.ckpt ")
    generator, _ = load_generator(tmp_path / "second" / CHECKPOINT)
    assert generator.decoder_channels == (8, 6, 4, 2)
    assert [len(stage) for stage in generator.stages] == [2, 1, 1, 2]


@pytest.mark.parametrize(
    ("change", "lack"),
    [
        ({"depths": (1, 1, 1, 1)}, r"further weights \(stages\.1\.1\.body\.0\.0\.weight\)"),
        ({"decoder": (8, 8, 8, 4)}, r"no weights for fusions\.2\.0\.weight"),
        ({"encoder": (4, 4, 8, 8, 16)}, "no weights for stages"),
        ({"encoder": (4, 4, 8, 8, 16), "decoder": (8, 6, 4, 2)}, "no weights for stages"),
    ],
    ids=["fewer blocks", "wider decoder", "other encoder", "other encoder, narrower decoder"],
)
def test_other_differences_are_refused(
    tmp_path: Path, change: dict[str, tuple[int, ...]], lack: str
) -> None:
    config = replace(WIDE, depths=(1, 2, 1, 1))
    train_two_steps(replace(BARE, generator=config), tmp_path)
    with pytest.raises(CheckpointError, match=rf"last\.ckpt has {lack}.*: set generator\.\* as"):
        load_init_weights(
            build_generator(replace(config, **change)), [tmp_path / CHECKPOINT], _gray
        )


def test_networks_of_two_kinds_have_no_mean(tmp_path: Path) -> None:
    train_two_steps(replace(BARE, generator=WIDE), tmp_path / "a")
    train_two_steps(replace(BARE, generator=NARROW), tmp_path / "b")
    files = [tmp_path / name / CHECKPOINT for name in "ab"]
    with pytest.raises(CheckpointError, match="are different networks, whose weights have no mean"):
        load_init_weights(build_generator(NARROW), files, _gray)


def test_the_networks_of_the_paper_take_only_their_own_weights() -> None:
    generator = build_generator(replace(SUPERVISED.generator, name="resnet", width=4, blocks=1))
    weights = generator.state_dict()
    assert resized_weights(generator, weights, pytest.fail).keys() == weights.keys()
