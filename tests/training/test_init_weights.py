"""Init weights: of models and checkpoints, and their mean."""

from dataclasses import replace
from pathlib import Path

import onnx
import pytest
import torch
from helpers.rooms import PAPER
from helpers.supervised_runs import BARE, SUPERVISED, train_two_steps

from depthcli.errors import CheckpointError
from depthcli.export.onnx import ExportOptions, export_checkpoint
from depthcli.training.checkpoint import CHECKPOINT, Checkpoint, load_generator
from depthcli.training.init_weights import load_init_weights
from depthcli.training.networks.build import build_generator
from depthcli.training.provenance import DataProvenance

NEW = DataProvenance()
WIDE = replace(BARE.generator, decoder=(16, 16, 16, 8))
NARROW = replace(WIDE, decoder=(16, 8, 8, 8))


def test_run_starts_from_a_model_and_states_it(tmp_path: Path) -> None:
    train_two_steps(SUPERVISED, tmp_path / "first")
    model = tmp_path / "first" / "model.onnx"
    exported = export_checkpoint(tmp_path / "first" / CHECKPOINT, model, ExportOptions("first"))
    taught, _ = load_generator(tmp_path / "first" / CHECKPOINT)
    generator = build_generator(BARE.generator).eval()
    origin = f"model.onnx {exported.card.sha256[:16]}"
    assert load_init_weights(generator, [model], NEW).init_weights == origin
    image = torch.rand(2, 1, 32, 32) * 2 - 1
    torch.testing.assert_close(generator(image), taught(image), atol=1e-4, rtol=1e-4)
    apart = tmp_path / "apart.onnx"
    onnx.save(onnx.load(model), apart, save_as_external_data=True, size_threshold=0)
    with pytest.raises(CheckpointError):
        load_init_weights(generator, [apart], NEW)

    second = tmp_path / "second"
    train_two_steps(BARE, second, model)
    assert Checkpoint.load(second / CHECKPOINT).provenance.init_weights == origin
    assert train_two_steps(BARE, second, model).step == 3
    assert train_two_steps(BARE, second).step == 3
    with pytest.raises(CheckpointError):
        train_two_steps(BARE, second, model.rename(tmp_path / "other.onnx"))
    card = export_checkpoint(second / CHECKPOINT, tmp_path / "b.onnx", ExportOptions("b")).card
    assert card.training["init_weights"] == origin


def test_learned_gain_of_the_input_is_a_weight(tmp_path: Path) -> None:
    """``generator.residual=input``: a checkpoint and its models give the same init weights."""
    config = replace(PAPER.generator, residual="input")
    train_two_steps(replace(PAPER, generator=config), tmp_path)
    taught, _ = load_generator(tmp_path / CHECKPOINT)
    assert taught.input_gain.detach() != 0
    model = tmp_path / "model.onnx"
    export_checkpoint(tmp_path / CHECKPOINT, model, ExportOptions("first"))
    averaging = onnx.load(model)  # a graph of 0.18 that averages with the mirrored image
    for tensor in averaging.graph.initializer:
        tensor.name = f"network.{tensor.name}"
    onnx.save(averaging, tmp_path / "mirrored.onnx")
    for source in (tmp_path / CHECKPOINT, model, tmp_path / "mirrored.onnx"):
        generator = build_generator(config).eval()
        load_init_weights(generator, [source], NEW)
        assert torch.equal(generator.input_gain, taught.input_gain)
        with pytest.raises(CheckpointError):
            load_init_weights(build_generator(PAPER.generator), [source], NEW)


def test_several_files_give_the_mean_of_their_weights(tmp_path: Path) -> None:
    files = [tmp_path / name / CHECKPOINT for name in "abc"]
    for seed, file in enumerate(files):
        train_two_steps(replace(SUPERVISED, seed=seed), file.parent)
    generator = build_generator(SUPERVISED.generator).eval()
    origin = load_init_weights(generator, files, NEW).init_weights
    assert origin.startswith("mean of last.ckpt ")
    assert origin.count("last.ckpt ") == 3
    states = [load_generator(file)[0].state_dict() for file in files]
    for name, weights in generator.state_dict().items():
        expected = sum(state[name].double() for state in states) / 3
        torch.testing.assert_close(weights.double(), expected, atol=1e-6, rtol=0)


def test_weights_of_other_networks_are_refused(tmp_path: Path) -> None:
    for name, generator in (("wide", WIDE), ("narrow", NARROW)):
        train_two_steps(replace(BARE, generator=generator), tmp_path / name)
    wide, narrow = (tmp_path / name / CHECKPOINT for name in ("wide", "narrow"))
    (tmp_path / "broken.onnx").write_bytes(b"no graph")
    for config, files in (
        (replace(WIDE, norm="batch"), [wide]),
        (WIDE, [narrow]),
        (replace(WIDE, encoder=(8, 8, 8, 8, 16)), [wide]),
        (WIDE, [tmp_path / "broken.onnx"]),
        (NARROW, [wide, narrow]),
    ):
        with pytest.raises(CheckpointError) as caught:
            load_init_weights(build_generator(config), files, NEW)
        assert "\n" not in str(caught.value)
