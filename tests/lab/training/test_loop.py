"""The loop: a stopped run goes on as if it had not stopped, and says what it does."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import pytest
import torch
from helpers.rooms import EFFICIENT, PAPER, room_data, rooms
from helpers.runs import same
from helpers.supervised_runs import BARE
from helpers.tiny_methods import batch
from lightning_fabric import Fabric

from depthcli.errors import CheckpointError, TrainingError, UsageError
from depthcli.lab.datasets.training_data import TrainingData
from depthcli.lab.metrics.depth import METRICS
from depthcli.lab.training.callbacks import Callback
from depthcli.lab.training.checkpoint import (
    BEST_CHECKPOINT,
    CHECKPOINT,
    METRICS_LOG,
    Checkpoint,
    TrainState,
    load_generator,
)
from depthcli.lab.training.config import TrainConfig
from depthcli.lab.training.run import Run, fit

CLIPPED = replace(PAPER, optim=replace(PAPER.optim, clip_norm=0.5, ema=0.9))
"""With discriminators, clipping and an average."""
RECIPES = {"paper": CLIPPED, "efficient": EFFICIENT}


class Notes(Callback):
    """A callback that remembers, and may fail on purpose."""

    def __init__(self, fail_at: int | None = None) -> None:
        self.steps: list[int] = []
        self.losses: list[dict[str, float]] = []
        self.epochs: list[TrainState] = []
        self.fail_at = fail_at

    def on_step_end(self, state: TrainState, steps: int, losses: dict[str, float]) -> None:
        assert steps >= state.step
        self.steps.append(state.step)
        self.losses.append(losses)
        if state.step == self.fail_at:
            raise KeyboardInterrupt

    def on_epoch_end(self, state: TrainState) -> None:
        self.epochs.append(state)


def _fabric() -> Fabric:
    return Fabric(accelerator="cpu", devices=1)


def _train(
    config: TrainConfig, folder: Path, notes: Notes | None = None, **limits: float
) -> TrainState:
    fabric = Fabric(accelerator="cpu", devices=1, precision=config.precision)
    return fit(config, room_data(), folder, fabric, notes or Notes(), **limits)


@pytest.mark.parametrize("name", RECIPES)
def test_resumed_run_is_bit_exact(tmp_path: Path, name: str) -> None:
    config, whole, parts = RECIPES[name], tmp_path / "whole", tmp_path / "parts"
    unbroken, broken = Notes(), Notes()
    done = _train(config, whole, unbroken)
    for steps in (3, 1, 100):  # in the middle of an epoch, one step, the rest
        torch.manual_seed(99)  # whatever the process did before
        last = _train(config, parts, broken, max_steps=steps)
    assert broken.steps == unbroken.steps == list(range(1, done.step + 1))
    assert broken.losses == unbroken.losses
    assert last.scores == done.scores
    a, b = (Checkpoint.load(folder / CHECKPOINT) for folder in (whole, parts))
    for field in ("method", "ema_generator", "optimizers", "extra", "rng"):
        assert same(getattr(a, field), getattr(b, field)), field
    assert a.ema_generator is not None
    if config.optim.pool_size:
        assert [len(images) for images in a.extra.values()] == [2, 2]


@pytest.mark.parametrize("monitor", ["rmse", "d1"])
def test_best_checkpoint_is_of_the_epoch_with_the_best_score(tmp_path: Path, monitor: str) -> None:
    notes = Notes()
    _train(replace(EFFICIENT, monitor=monitor), tmp_path, notes)
    scores = {state.epoch: state.scores[monitor] for state in notes.epochs}
    choose = max if METRICS[monitor].higher_is_better else min
    best = Checkpoint.load(tmp_path / BEST_CHECKPOINT).state
    assert (best.epoch, best.best_score) == (
        choose(scores, key=scores.__getitem__),
        scores[best.epoch],
    )


def test_run_without_better_epochs_ends_and_stays_ended(tmp_path: Path) -> None:
    optim = replace(BARE.optim, learning_rate=0.0, epochs_constant=9)
    config = replace(BARE, optim=optim, patience=2)
    done = _train(config, tmp_path)
    assert (done.epoch, done.best_epoch) == (3, 1)
    notes = Notes()
    assert _train(config, tmp_path, notes) == done
    assert not notes.steps


def test_patience_needs_held_out_pairs(tmp_path: Path) -> None:
    config = replace(PAPER, patience=1, data=replace(PAPER.data, holdout_every=0))
    with pytest.raises(UsageError):
        _train(config, tmp_path)


def test_run_killed_between_checkpoints_repeats_from_the_last(tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    _train(EFFICIENT, whole)
    with pytest.raises(KeyboardInterrupt):
        _train(EFFICIENT, parts, Notes(fail_at=3))
    assert Checkpoint.load(parts / CHECKPOINT).state.step == 2
    assert Checkpoint.load(parts / CHECKPOINT).state.threads == torch.get_num_threads()
    again = Notes()
    _train(EFFICIENT, parts, again)
    assert again.steps == [3, 4, 5, 6]
    a, b = (Checkpoint.load(folder / CHECKPOINT) for folder in (whole, parts))
    assert same(a.method, b.method)


def test_log_samples_and_checkpoint_of_a_run(tmp_path: Path) -> None:
    notes = Notes()
    done = _train(EFFICIENT, tmp_path, notes)
    assert (done.step, done.epoch) == (6, 3)
    provenance = Checkpoint.load(tmp_path / CHECKPOINT).provenance
    assert provenance.train_ids == ("0000", "0001", "0003", "0004", "0005")
    assert provenance.held_out_ids == ("0002",)
    lines = [json.loads(line) for line in (tmp_path / METRICS_LOG).read_text().splitlines()]
    assert [line["epoch"] for line in lines] == [1, 2, 3]
    assert [line["step"] for line in lines] == [2, 4, 6]
    assert [set(line["losses"]) for line in lines] == [{"l1", "gradient"}] * 3
    assert [list(line["scores"]) for line in lines] == [list(METRICS)] * 3
    assert [p.epoch for p in notes.epochs] == [1, 2, 3]
    assert lines[-1]["scores"]["abs_rel"] == done.scores["abs_rel"]
    assert 0 <= lines[0]["seconds"] <= lines[-1]["seconds"] < 60
    images = sorted((tmp_path / "samples").iterdir())
    assert [p.name for p in images] == [f"epoch-000{i}.jpg" for i in (1, 2, 3)]
    assert cv2.imread(str(images[0])).shape == (32, 3 * 64, 3)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        BEST_CHECKPOINT,
        CHECKPOINT,
        METRICS_LOG,
        "samples",
    ]


def test_validation_every_few_epochs_and_at_the_end(tmp_path: Path) -> None:
    _train(replace(EFFICIENT, validate_every=2), tmp_path)
    assert [p.name for p in sorted((tmp_path / "samples").iterdir())] == [
        "epoch-0002.jpg",
        "epoch-0003.jpg",
    ]
    lines = (tmp_path / "metrics.jsonl").read_text().splitlines()
    assert [bool(json.loads(line)["scores"]) for line in lines] == [False, True, True]


def test_scores_are_of_the_weights_they_are_saved_with(tmp_path: Path) -> None:
    assert _train(EFFICIENT, tmp_path, max_steps=2).scores
    assert _train(EFFICIENT, tmp_path, max_steps=1).scores == {}
    assert Checkpoint.load(tmp_path / CHECKPOINT).state.scores == {}


def test_checkpoint_every_few_epochs_and_at_the_end(tmp_path: Path) -> None:
    class SavedSteps(Notes):
        def on_epoch_end(self, state: TrainState) -> None:
            super().on_epoch_end(state)
            saved.append(Checkpoint.load(path).state.epoch if path.exists() else None)

    path, saved = tmp_path / CHECKPOINT, list[int | None]()
    _train(replace(EFFICIENT, save_every=2), tmp_path, SavedSteps())
    assert saved == [None, 2, 3]


def test_run_without_held_out_pairs(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    config = replace(EFFICIENT, data=replace(EFFICIENT.data, holdout_every=0))
    with caplog.at_level("INFO"):
        done = _train(config, tmp_path, max_steps=3)
    assert not caplog.records  # whoever calls says what is said
    provenance = Checkpoint.load(tmp_path / CHECKPOINT).provenance
    assert (len(provenance.train_ids), provenance.held_out_ids, done.scores) == (6, (), {})
    assert not (tmp_path / "samples").exists()


def test_the_run_says_what_it_learned_from(tmp_path: Path) -> None:
    square = replace(rooms(), images=rooms().images[:, :, :48], depths_m=rooms().depths_m[..., :48])
    for data, of_camera in (
        (TrainingData(square, "square rooms", None), (None, 1.0)),
        (TrainingData(rooms(), "six rooms", 70.0), (70.0, 4 / 3)),
    ):
        folder = tmp_path / data.title
        fit(EFFICIENT, data, folder, _fabric(), Notes(), max_steps=1)
        saved = Checkpoint.load(folder / CHECKPOINT).provenance
        assert (saved.data, saved.hfov_deg, saved.aspect) == (data.title, *of_camera)
        assert (saved.pseudo_labels, saved.init_weights) == ("", "")


def test_rate_follows_the_schedule() -> None:
    run = Run(PAPER, _fabric(), steps_per_epoch=5)
    for step in (0, 5, 9):
        run.state = TrainState(step=step)
        run.step(batch())
        rate = 2e-4 * PAPER.optim.lr_factor(step, 5)
        rates = {g["lr"] for o in run.optimizers.values() for g in o.param_groups}
        assert rates == {rate}


def test_only_matrices_and_kernels_decay() -> None:
    run = Run(EFFICIENT, _fabric(), steps_per_epoch=5)
    groups = run.optimizers["generator"].param_groups
    assert [g["weight_decay"] for g in groups] == [0.05, 0]
    assert [{w.ndim > 1 for w in g["params"]} for g in groups] == [{True}, {False}]
    total = sum(w.numel() for g in groups for w in g["params"])
    assert total == sum(w.numel() for w in run.method.parameters())


def test_discriminators_are_not_clipped_and_generators_are() -> None:
    config = replace(PAPER, optim=replace(PAPER.optim, clip_norm=1e-9))
    run = Run(config, _fabric(), steps_per_epoch=5)
    norms = {}
    for phase, optimizer in run.optimizers.items():
        optimizer.register_step_pre_hook(_note_norm(norms, phase))
    run.step(batch())
    assert norms["generator"] <= 1.01e-9
    assert norms["discriminator"] > 1e-6


def _note_norm(norms: dict[str, float], phase: str) -> Any:
    def note(optimizer: torch.optim.Optimizer, *_: object) -> None:
        grads = [w.grad.norm() for g in optimizer.param_groups for w in g["params"]]
        norms[phase] = float(torch.stack(grads).norm())

    return note


@pytest.mark.parametrize("recipe", RECIPES.values(), ids=RECIPES)
def test_infinite_loss_keeps_the_last_checkpoint(tmp_path: Path, recipe: TrainConfig) -> None:
    config = replace(recipe, optim=replace(recipe.optim, learning_rate=1e30))
    _train(config, tmp_path, max_steps=1)
    before = (tmp_path / CHECKPOINT).read_bytes()
    with pytest.raises(TrainingError):
        _train(config, tmp_path)
    assert (tmp_path / CHECKPOINT).read_bytes() == before
    assert Checkpoint.load(tmp_path / CHECKPOINT).state.step == 1


def test_weights_that_are_not_finite_do_not_replace_a_checkpoint(tmp_path: Path) -> None:
    run = Run(PAPER, _fabric(), steps_per_epoch=5)
    run.save(tmp_path / CHECKPOINT)
    before = (tmp_path / CHECKPOINT).read_bytes()
    with torch.no_grad():
        next(run.method.gray_discriminator.parameters()).view(-1)[0] = float("nan")
    with pytest.raises(TrainingError):
        run.save(tmp_path / CHECKPOINT)
    assert (tmp_path / CHECKPOINT).read_bytes() == before


def test_weights_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    _train(EFFICIENT, tmp_path, max_steps=1)
    path = tmp_path / CHECKPOINT
    saved = Checkpoint.load(path)
    lacking = {name: w for name, w in saved.method.items() if name != "generator.head.bias"}
    for changed in ({"method": lacking}, {"optimizers": {}}, {"ema_generator": None}):
        replace(saved, **changed).save(path)
        with pytest.raises(CheckpointError):
            _train(EFFICIENT, tmp_path)
    for group in saved.optimizers["generator"]["param_groups"]:
        group["betas"] = (2, -5)  # the configuration says what they are
    saved.save(path)
    assert _train(EFFICIENT, tmp_path, max_steps=1).step == 2


def test_mixed_precision_trains_and_keeps_full_weights(tmp_path: Path) -> None:
    config = replace(PAPER, precision="bf16-mixed")
    notes = Notes()
    _train(config, tmp_path, notes, max_steps=2)
    assert len(notes.losses) == 2
    generator, _ = load_generator(tmp_path / CHECKPOINT)
    assert {p.dtype for p in generator.parameters()} == {torch.float32}
