"""Pseudo labels, whose metres are less sure, and weights to start from."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import onnx
import pytest
import torch
from helpers.rooms import PAPER, TRAIN, rooms
from helpers.supervised_runs import BARE, SUPERVISED, train_two_steps, write_extra

from depthcli.errors import CheckpointError, UsageError
from depthcli.export.onnx import ExportOptions, export_checkpoint
from depthcli.training.checkpoint import CHECKPOINT, Checkpoint, TrainState, load_generator
from depthcli.training.config import OutputConfig
from depthcli.training.data import Batches, PairStore, TrainingBatch
from depthcli.training.initial_weights import coding_differences, load_init_weights
from depthcli.training.methods.proposed import Proposed
from depthcli.training.methods.registry import default_config
from depthcli.training.networks.build import build_generator
from depthcli.training.settings import updated

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

    from depthcli.training.config import TrainConfig

CPU = torch.device("cpu")


def test_a_batch_has_its_share_of_extra_pairs() -> None:
    data = replace(PAPER.data, pseudo_label_share=0.25, zoom=1.2, turn=1.0)
    store, dark = PairStore(rooms(), TRAIN, data), PairStore(rooms(), TRAIN, data)
    dark.rgb.zero_()
    batches = Batches(store, data, 4, 0, CPU, extra=dark)
    assert batches.steps_per_epoch == len(TRAIN) // 3
    for step in range(4):
        batch = batches[step]
        assert batch.is_pseudo_label is not None
        assert batch.is_pseudo_label.tolist() == [False, False, False, True]
        darkness = (batch.network_input == -1).all(3).all(2).all(1)
        assert torch.equal(darkness, batch.is_pseudo_label)
        again = batches[step]
        assert torch.equal(again.network_input, batch.network_input)
    seen = torch.cat(
        [batches._rows(dark, step, batches._extra_size, stream=4) for step in range(5)]
    )
    assert sorted(seen.tolist()) == list(range(5))


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_a_share_that_is_no_part_of_a_batch_is_refused(share: float) -> None:
    data = replace(PAPER.data, pseudo_label_share=share)
    store = PairStore(rooms(), TRAIN, data)
    with pytest.raises(UsageError, match=r"data\.pseudo_label_share"):
        Batches(store, data, 4, 0, CPU, extra=store)


def _pull(method: Proposed, gray: Tensor, depth_m: Tensor, extra: Tensor) -> float:
    """Derivative of eq. 1 with respect to a constant added to the output, log depth."""
    shift = torch.zeros((), requires_grad=True)
    with method.generator.register_forward_hook(lambda *call: call[2] + shift):
        l1 = method(TrainingBatch(gray, depth_m, None, extra), "generator")["l1"]
    return float(torch.autograd.grad(l1, shift)[0])


@pytest.mark.parametrize("scale", [0.0, 0.4, 1.0])
def test_the_scale_of_an_extra_pair_counts_in_part(scale: float) -> None:
    """A truth that is farther by a factor costs its logarithm times ``pseudo_label_scale``."""
    torch.manual_seed(0)
    method = Proposed(
        replace(SUPERVISED, loss=replace(SUPERVISED.loss, pseudo_label_scale=scale))
    ).eval()
    gray = torch.rand(2, 1, 32, 32) * 2 - 1
    depth_m = method.codec.decode(method.generator(gray).detach().numpy())
    depth_m = torch.nn.functional.interpolate(torch.from_numpy(depth_m), (32, 32))
    farther = depth_m * 1.5
    uneven = farther.clone()
    uneven[..., 16:, 16:] *= 2
    for extra in (torch.tensor([True, True]), torch.tensor([False, False])):
        same = method(TrainingBatch(gray, depth_m, None, extra), "generator")["l1"]
        apart = method(TrainingBatch(gray, farther, None, extra), "generator")["l1"]
        wanted = torch.log(torch.tensor(1.5)) / method.codec.scale
        wanted = wanted * scale if extra[0] else wanted
        assert float(same.detach()) == pytest.approx(0, abs=1e-6)
        assert float(apart.detach()) == pytest.approx(float(wanted), abs=1e-4)
        pull = _pull(method, gray, uneven, extra)
        assert pull == pytest.approx(-scale if extra[0] else -1, abs=1e-6)


def test_what_is_not_known_of_an_extra_pair_does_not_move_its_scale() -> None:
    torch.manual_seed(0)
    method = Proposed(SUPERVISED).eval()
    gray, depth_m = torch.rand(2, 1, 32, 32) * 2 - 1, torch.rand(2, 1, 32, 32) * 3 + 1
    valid_mask = torch.ones(2, 1, 32, 32, dtype=torch.bool)
    valid_mask[..., :16] = False
    wild = torch.where(valid_mask, depth_m, torch.tensor(9.0))
    extra = torch.tensor([True, True])
    one = method(TrainingBatch(gray, depth_m, valid_mask, extra), "generator")["l1"]
    other = method(TrainingBatch(gray, wild, valid_mask, extra), "generator")["l1"]
    torch.testing.assert_close(one, other)


def test_a_run_starts_from_a_model_and_says_so(tmp_path: Path) -> None:
    train_two_steps(SUPERVISED, tmp_path / "first")
    model = tmp_path / "first" / "model.onnx"
    exported = export_checkpoint(tmp_path / "first" / CHECKPOINT, model, ExportOptions("first"))
    taught, _ = load_generator(tmp_path / "first" / CHECKPOINT)
    generator = build_generator(BARE.generator).eval()
    assert (
        load_init_weights(generator, [model], pytest.fail)
        == f"model.onnx {exported.card.sha256[:16]}"
    )
    gray = torch.rand(2, 1, 32, 32) * 2 - 1
    torch.testing.assert_close(generator(gray), taught(gray), atol=1e-4, rtol=1e-4)
    apart = tmp_path / "apart.onnx"
    onnx.save(onnx.load(model), apart, save_as_external_data=True, size_threshold=0)
    with pytest.raises(CheckpointError, match=r"apart\.onnx is not a complete ONNX file with"):
        load_init_weights(generator, [apart], pytest.fail)

    extra = write_extra(tmp_path / "extra")
    train_two_steps(BARE, tmp_path / "second", model, extra)
    progress = Checkpoint.load(tmp_path / "second" / CHECKPOINT).state
    assert progress.start == f"model.onnx {exported.card.sha256[:16]}"
    assert progress.extra == "6 pseudo labels (extra)"
    assert train_two_steps(BARE, tmp_path / "second", model, extra).step == 4
    with pytest.raises(CheckpointError, match="another run: extra is"):
        train_two_steps(BARE, tmp_path / "second", model)
    assert train_two_steps(BARE, tmp_path / "second", None, extra).step == 6
    renamed = model.rename(tmp_path / "other.onnx")
    with pytest.raises(CheckpointError, match="another run: start is"):
        train_two_steps(BARE, tmp_path / "second", renamed, extra)
    card = export_checkpoint(
        tmp_path / "second" / CHECKPOINT, tmp_path / "second.onnx", ExportOptions("second")
    ).card
    assert card.training is not None
    assert card.training["start"] == progress.start
    assert card.training["extra"] == progress.extra


def test_a_checkpoint_gives_its_weights(tmp_path: Path) -> None:
    train_two_steps(SUPERVISED, tmp_path)
    generator = build_generator(SUPERVISED.generator).eval()
    load_init_weights(generator, [tmp_path / CHECKPOINT], pytest.fail)
    taught, _ = load_generator(tmp_path / CHECKPOINT)
    for name, weights in generator.state_dict().items():
        assert torch.equal(weights, taught.state_dict()[name])


@pytest.mark.parametrize("mirror", [False, True])
def test_the_learned_gain_of_the_input_is_a_weight(tmp_path: Path, *, mirror: bool) -> None:
    """``generator.residual=input``: a checkpoint and its model give the same start."""
    config = replace(PAPER.generator, residual="input")
    train_two_steps(replace(PAPER, generator=config), tmp_path)
    taught, _ = load_generator(tmp_path / CHECKPOINT)
    assert taught.input_gain.detach() != 0
    model = tmp_path / "model.onnx"
    export_checkpoint(tmp_path / CHECKPOINT, model, ExportOptions("first", mirror=mirror))
    for source in (tmp_path / CHECKPOINT, model):
        generator = build_generator(config).eval()
        load_init_weights(generator, [source], pytest.fail)
        assert torch.equal(generator.input_gain, taught.input_gain)
        with pytest.raises(CheckpointError, match=r"has further weights \(input_gain\): set gener"):
            load_init_weights(build_generator(PAPER.generator), [source], pytest.fail)


def test_several_give_the_mean_of_their_weights(tmp_path: Path) -> None:
    files = [tmp_path / name / CHECKPOINT for name in "abc"]
    for seed, file in enumerate(files):
        train_two_steps(replace(SUPERVISED, seed=seed), file.parent)
    generator = build_generator(SUPERVISED.generator).eval()
    started = load_init_weights(generator, files, pytest.fail)
    assert started.startswith("mean of last.ckpt ")
    assert started.count("last.ckpt ") == 3
    states = [load_generator(file)[0].state_dict() for file in files]
    for name, weights in generator.state_dict().items():
        expected = sum(state[name].double() for state in states) / 3
        torch.testing.assert_close(weights.double(), expected, atol=1e-6, rtol=0)


def _untrained(config: TrainConfig, folder: Path) -> Path:
    """A folder with a checkpoint before the first step, and its model."""
    weights = build_generator(config.generator).state_dict()
    named = {f"generator.{name}": value for name, value in weights.items()}
    checkpoint = Checkpoint(config, TrainState(), named, None, {}, {}, torch.get_rng_state())
    checkpoint.save(folder / "last.ckpt")
    export_checkpoint(folder / "last.ckpt", folder / "last.onnx", ExportOptions("model"))
    return folder


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of ``BARE``."""
    return _untrained(BARE, tmp_path_factory.mktemp("bare"))


OTHER_CODINGS = [
    ({"output": {"max_m": 80.0}}, "output.max_m is 80.0 there, 10.0 here"),
    ({"output": {"coding": "linear"}}, 'output.coding is "linear" there, "log" here'),
    ({"output": {"min_m": 0.5}}, "output.min_m is 0.5 there, 0.4 here"),
    ({"data": {"colour": "luma"}}, 'data.colour is "luma" there, "value" here'),
]


@pytest.mark.parametrize(("other", "line"), OTHER_CODINGS)
def test_weights_of_another_coding_have_no_mean_and_are_told(
    tmp_path: Path, bare: Path, other: dict[str, dict[str, object]], line: str
) -> None:
    another = _untrained(updated(BARE, other), tmp_path)
    for name in ("last.ckpt", "last.onnx"):
        files = [bare / name, another / name]
        message = re.escape(f"{files[1]} encodes colour or depth in another way than {files[0]} ")
        message += rf"\({re.escape(line)}\), so their weights have no mean"
        with pytest.raises(CheckpointError, match=message):
            load_init_weights(build_generator(BARE.generator), files, pytest.fail)
        assert coding_differences(BARE, files[1:]) == (line,)
        assert coding_differences(BARE, files[:1]) == coding_differences(BARE, []) == ()


def test_of_weights_without_depth_the_colour_alone_is_compared(tmp_path: Path) -> None:
    masked = replace(default_config("masked"), data=SUPERVISED.data, output=OutputConfig(max_m=80))
    masked = replace(masked, generator=SUPERVISED.generator, optim=SUPERVISED.optim)
    train_two_steps(masked, tmp_path)
    assert coding_differences(SUPERVISED, [tmp_path / CHECKPOINT]) == ()
    luma = updated(SUPERVISED, {"data": {"colour": "luma"}})
    assert len(coding_differences(luma, [tmp_path / CHECKPOINT])) == 1


def test_weights_of_other_networks_are_refused(tmp_path: Path) -> None:
    train_two_steps(SUPERVISED, tmp_path)
    with pytest.raises(CheckpointError, match=r"no weights for stem\.0\.bias"):
        load_init_weights(build_generator(BARE.generator), [tmp_path / CHECKPOINT], pytest.fail)
    wider = replace(SUPERVISED.generator, decoder=(8, 8, 4, 8))
    with pytest.raises(CheckpointError, match=r"no weights for fusions\.3\.0\.weight"):
        load_init_weights(build_generator(wider), [tmp_path / CHECKPOINT], pytest.fail)
    (tmp_path / "broken.onnx").write_bytes(b"no graph")
    with pytest.raises(CheckpointError, match=r"broken\.onnx is not a complete ONNX file"):
        load_init_weights(build_generator(BARE.generator), [tmp_path / "broken.onnx"], pytest.fail)


def test_extra_pairs_need_log_depth(tmp_path: Path) -> None:
    extra = write_extra(tmp_path / "extra")
    config = replace(SUPERVISED, output=replace(SUPERVISED.output, coding="linear"))
    with pytest.raises(UsageError, match=r"output\.coding=log"):
        train_two_steps(config, tmp_path / "run", None, extra)
