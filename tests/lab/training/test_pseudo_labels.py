"""What a run starts from: weights of another, pseudo labels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from helpers.made import exif, jpeg_with_exif
from helpers.rooms import PAPER, TRAIN, batches_of, room_data, rooms
from helpers.supervised_runs import BARE, SUPERVISED, train_steps, write_pseudo_labels
from helpers.tiny import write_image, write_model
from torch import Tensor

from depthcli.cli.app import main
from depthcli.errors import CheckpointError, UsageError
from depthcli.lab.datasets.folders import open_paired_folder
from depthcli.lab.export.onnx import ExportOptions, export_checkpoint
from depthcli.lab.training.checkpoint import CHECKPOINT, Checkpoint, load_generator
from depthcli.lab.training.data import PairStore, TrainingBatch
from depthcli.lab.training.init_weights import load_init_weights
from depthcli.lab.training.methods.proposed import Proposed
from depthcli.lab.training.networks.build import build_generator
from depthcli.lab.training.provenance import DataProvenance

NEW = DataProvenance()
WIDE = replace(BARE.generator, decoder=(16, 16, 16, 8))
NARROW = replace(WIDE, decoder=(16, 8, 8, 8))


def test_run_starts_from_a_model_and_states_it(tmp_path: Path) -> None:
    train_steps(SUPERVISED, tmp_path / "first")
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
    train_steps(BARE, second, model)
    assert Checkpoint.load(second / CHECKPOINT).provenance.init_weights == origin
    assert train_steps(BARE, second, model).step == 3
    assert train_steps(BARE, second).step == 3
    with pytest.raises(CheckpointError):
        train_steps(BARE, second, model.rename(tmp_path / "other.onnx"))
    card = export_checkpoint(second / CHECKPOINT, tmp_path / "b.onnx", ExportOptions("b")).card
    assert card.training["init_weights"] == origin


def test_learned_gain_of_the_input_is_a_weight(tmp_path: Path) -> None:
    """``generator.residual=input``: a checkpoint and its models give the same init weights."""
    config = replace(PAPER.generator, residual="input")
    train_steps(replace(PAPER, generator=config), tmp_path)
    taught, _ = load_generator(tmp_path / CHECKPOINT)
    assert taught.input_gain.detach() != 0
    model = tmp_path / "model.onnx"
    export_checkpoint(tmp_path / CHECKPOINT, model, ExportOptions("first"))
    for source in (tmp_path / CHECKPOINT, model):
        generator = build_generator(config).eval()
        load_init_weights(generator, [source], NEW)
        assert torch.equal(generator.input_gain, taught.input_gain)
        with pytest.raises(CheckpointError):
            load_init_weights(build_generator(PAPER.generator), [source], NEW)


def test_several_files_give_the_mean_of_their_weights(tmp_path: Path) -> None:
    files = [tmp_path / name / CHECKPOINT for name in "abc"]
    for seed, file in enumerate(files):
        train_steps(replace(SUPERVISED, seed=seed), file.parent)
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
        train_steps(replace(BARE, generator=generator), tmp_path / name)
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


CPU = torch.device("cpu")
GRAY, SEEN_M = 128, 5 + 4 * (2 * 128 / 255 - 1)
"""An image of one brightness, and the depth that the tiny model sees in it at any size."""


def test_batch_has_its_share_of_pseudo_labels() -> None:
    data = replace(PAPER.data, pseudo_label_share=0.25, zoom=1.2, turn=1.0)
    store, dark = PairStore(rooms(), TRAIN, data), PairStore(rooms(), TRAIN, data)
    dark.rgb.zero_()
    batches = batches_of(store, data, 4, pseudo_labels=dark)
    assert batches.steps_per_epoch == len(TRAIN) // 3
    for step in range(4):
        batch = batches[step]
        assert batch.is_pseudo_label.tolist() == [False, False, False, True]
        darkness = (batch.network_input == -1).all(3).all(2).all(1)
        assert torch.equal(darkness, batch.is_pseudo_label)
        assert torch.equal(batches[step].network_input, batch.network_input)


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_share_below_one_pair_is_refused(share: float) -> None:
    data = replace(PAPER.data, pseudo_label_share=share)
    store = PairStore(rooms(), TRAIN, data)
    with pytest.raises(UsageError):
        batches_of(store, data, 4, pseudo_labels=store)


def _pull(method: Proposed, image: Tensor, depth_m: Tensor, is_label: Tensor) -> float:
    """Derivative of eq. 1 with respect to a constant added to the output, log depth."""
    shift = torch.zeros((), requires_grad=True)
    with method.generator.register_forward_hook(lambda *call: call[2] + shift):
        l1 = method(TrainingBatch(image, depth_m, None, is_label), "generator")["l1"]
    return float(torch.autograd.grad(l1, shift)[0])


@pytest.mark.parametrize("scale", [0.0, 0.4, 1.0])
def test_scale_of_a_pseudo_label_counts_in_part(scale: float) -> None:
    """A truth that is farther by a factor costs its logarithm times ``pseudo_label_scale``."""
    torch.manual_seed(0)
    loss = replace(SUPERVISED.loss, pseudo_label_scale=scale)
    method = Proposed(replace(SUPERVISED, loss=loss)).eval()
    image = torch.rand(2, 1, 32, 32) * 2 - 1
    depth_m = method.codec.decode(method.generator(image).detach().numpy())
    depth_m = torch.nn.functional.interpolate(torch.from_numpy(depth_m), (32, 32))
    farther = depth_m * 1.5
    uneven = farther.clone()
    uneven[..., 16:, 16:] *= 2
    for is_label in (torch.tensor([True, True]), torch.tensor([False, False])):
        same = method(TrainingBatch(image, depth_m, None, is_label), "generator")["l1"]
        apart = method(TrainingBatch(image, farther, None, is_label), "generator")["l1"]
        expected = torch.log(torch.tensor(1.5)) / method.codec.scale
        expected = expected * scale if is_label[0] else expected
        assert float(same.detach()) == pytest.approx(0, abs=1e-6)
        assert float(apart.detach()) == pytest.approx(float(expected), abs=1e-4)
        pull = _pull(method, image, uneven, is_label)
        assert pull == pytest.approx(-scale if is_label[0] else -1, abs=1e-6)


def test_invalid_pixels_do_not_move_the_scale_of_a_pseudo_label() -> None:
    torch.manual_seed(0)
    method = Proposed(SUPERVISED).eval()
    image, depth_m = torch.rand(2, 1, 32, 32) * 2 - 1, torch.rand(2, 1, 32, 32) * 3 + 1
    valid_mask = torch.ones(2, 1, 32, 32, dtype=torch.bool)
    valid_mask[..., :16] = False
    wild, is_label = torch.where(valid_mask, depth_m, torch.tensor(9.0)), torch.tensor([True, True])
    clean = method(TrainingBatch(image, depth_m, valid_mask, is_label), "generator")["l1"]
    other = method(TrainingBatch(image, wild, valid_mask, is_label), "generator")["l1"]
    torch.testing.assert_close(clean, other)


def test_run_states_its_pseudo_labels_and_needs_them_to_resume(tmp_path: Path) -> None:
    labels, run = write_pseudo_labels(tmp_path / "more"), tmp_path / "run"
    train_steps(SUPERVISED, run, None, labels)
    pseudo_labels = Checkpoint.load(run / CHECKPOINT).provenance.pseudo_labels
    assert pseudo_labels == "6 pseudo labels (more)"
    with pytest.raises(CheckpointError):
        train_steps(SUPERVISED, run)
    moved = labels.rename(tmp_path / "moved")
    assert train_steps(SUPERVISED, run, None, moved).step == 4
    card = export_checkpoint(run / CHECKPOINT, run / "run.onnx", ExportOptions("run")).card
    assert card.training["pseudo_labels"] == pseudo_labels


def test_pseudo_labels_need_log_depth(tmp_path: Path) -> None:
    labels = write_pseudo_labels(tmp_path / "more")
    config = replace(SUPERVISED, output=replace(SUPERVISED.output, coding="linear"))
    with pytest.raises(UsageError):
        train_steps(config, tmp_path / "run", None, labels)


@pytest.fixture
def more(tmp_path: Path) -> Path:
    """Images of three cameras, and their depth as predicted by ``batch``."""
    camera = {"camera": {"hfov_deg": 63.3}, "input__width": 192, "input__height": 144}
    model = write_model(tmp_path / "model", input__fit="keep-aspect", **camera)
    for name, (height, width) in {"room": (72, 96), "wide": (72, 128), "lens": (96, 72)}.items():
        image = np.full((height, width, 3), GRAY, np.uint8)
        write_image(tmp_path / "more" / "rgb" / f"{name}.jpg", image)
    lens = tmp_path / "more" / "rgb" / "lens.jpg"
    lens.write_bytes(jpeg_with_exif(lens.read_bytes(), exif(focal_35mm=26)))
    words = ["batch", str(lens.parent), "--out", str(tmp_path / "more" / "depth"), "--quiet"]
    assert main([*words, "--format", "png16", "--upsample", "bilinear", "--model", str(model)]) == 0
    return tmp_path / "more"


def test_metres_of_any_camera_become_those_of_the_trained_one(more: Path) -> None:
    """``batch`` multiplied them by the ratio of focal lengths, which the network cannot see."""
    pairs = open_paired_folder(more)
    labels = room_data().with_pseudo_labels(pairs).pseudo_labels
    assert pairs.ids == ("lens", "room", "wide")
    for i, ratio in enumerate((0.926, 1, 1.155)):
        # The input has whole pixels: up to a half percent from the ideal size.
        assert np.median(pairs.depth_m(i)) == pytest.approx(SEEN_M * ratio, rel=0.006)
        assert np.median(labels.depth_m(i)) == pytest.approx(SEEN_M, rel=0.006)


def test_cameras_csv_comes_before_the_focal_lengths_of_depth_images(more: Path) -> None:
    (more / "cameras.csv").write_text("id,focal_px\nlens,100\nroom,200\nwide,400\n")
    pairs = open_paired_folder(more)
    assert room_data().with_pseudo_labels(pairs).pseudo_labels == pairs.for_camera(63.3, 4 / 3)
