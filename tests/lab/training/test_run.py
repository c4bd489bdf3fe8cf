"""A training run, and runs of several seeds."""

import json
import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from helpers.rooms import EFFICIENT, PAPER, TRAIN, Rooms, batches_of, room_data
from helpers.tiny_methods import tiny
from lightning_fabric import Fabric
from lightning_fabric.plugins.precision.amp import MixedPrecision
from torch import nn

from depthcli.core.parallel import usable_cores
from depthcli.lab.training.callbacks import Callback
from depthcli.lab.training.checkpoint import CHECKPOINT, Checkpoint
from depthcli.lab.training.config import DataConfig, OptimConfig, TrainConfig, updated
from depthcli.lab.training.data import PairStore, TrainingBatch
from depthcli.lab.training.methods.proposed import Proposed
from depthcli.lab.training.methods.table import PAPER_METHODS
from depthcli.lab.training.run import (
    Run,
    WeightAverage,
    fit,
    load_random_state,
    random_state,
    set_threads,
)

PLAIN = {"loss": {"contrast_x": 0.0, "contrast_y": 0.0}, "optim": {"pool_size": 0}}
"""Nothing is drawn by chance."""


@pytest.mark.parametrize("config", [EFFICIENT, PAPER], ids=["efficient", "resnet"])
def test_networks_are_channels_last(config: TrainConfig) -> None:
    run = Run(config, Fabric(accelerator="cpu", devices=1), 5)
    kernels = [weight for weight in run.method.parameters() if weight.ndim == 4]
    assert kernels
    assert all(k.is_contiguous(memory_format=torch.channels_last) for k in kernels)


def _half(config: TrainConfig, scale: float = 64.0) -> Fabric:
    """Half precision with a scaler that changes at every step, on a CPU."""
    scaler = torch.amp.GradScaler("cpu", init_scale=scale, growth_interval=1)
    plugin = MixedPrecision("16-mixed", "cpu", scaler)
    assert config.precision == "16-mixed"
    return Fabric(accelerator="cpu", devices=1, plugins=[plugin])


def test_half_precision_resumes_with_its_scale(tmp_path: Path) -> None:
    config = replace(EFFICIENT, precision="16-mixed")
    for steps, out in ((4, "whole"), (2, "parts"), (2, "parts")):
        fit(config, room_data(), tmp_path / out, _half(config), Callback(), max_steps=steps)
    whole, parts = (Checkpoint.load(tmp_path / out / CHECKPOINT) for out in ("whole", "parts"))
    assert whole.precision["scale"] == 64 * 2**4
    assert parts.precision == whole.precision
    for name, weight in whole.method.items():
        assert torch.equal(weight, parts.method[name]), name


def test_a_scale_that_overflows_skips_the_step_and_is_halved() -> None:
    """Also where gradients are clipped: those that are not finite have no norm to clip."""
    config = replace(EFFICIENT, precision="16-mixed")
    assert config.optim.clip_norm
    fabric = _half(config, scale=2.0**120)
    run = Run(config, fabric, 5)
    before = [weight.clone() for weight in run.method.parameters()]
    batch = TrainingBatch(torch.rand(2, 1, 32, 64) * 2 - 1, torch.rand(2, 1, 32, 64) * 5 + 1)
    assert all(math.isfinite(loss) for loss in run.step(batch).values())
    assert fabric.strategy.precision.state_dict()["scale"] == 2.0**119
    for was, weight in zip(before, run.method.parameters(), strict=True):
        assert torch.equal(was, weight)


COSINE = [min(1, (i + 1) / 4) * (1 + math.cos(math.pi * i / 20)) / 2 for i in range(20)]


@pytest.mark.parametrize(
    ("epochs", "more", "rates"),
    [
        ((1, 3), {}, [1, 1, 0.75, 0.75, 0.5, 0.5, 0.25, 0.25]),
        ((1, 1), {"warmup_steps": 4}, [1 / 4, 2 / 4, 3 / 4, 1 / 2, 1 / 2, 1 / 2]),
        ((0, 5), {"warmup_steps": 4, "schedule": "cosine"}, COSINE),
    ],
)
def test_rates(epochs: tuple[int, int], more: dict[str, Any], rates: list[float]) -> None:
    optim = OptimConfig(epochs_constant=epochs[0], epochs_decay=epochs[1], **more)
    count = len(rates) // sum(epochs)
    assert [optim.lr_factor(i, count) for i in range(len(rates))] == pytest.approx(rates)


def test_follows_the_decay_and_forgets_the_first_weights_soon() -> None:
    network = nn.Linear(1, 1, bias=False)
    nn.init.constant_(network.weight, 5)
    average, expected = WeightAverage(network, 0.5), 5.0
    for step in range(1, 20):
        nn.init.constant_(network.weight, float(step))
        average.update(network, step)
        decay = min(0.5, step / (step + 9))
        expected = decay * expected + (1 - decay) * step
        assert average.network.weight.item() == pytest.approx(expected, rel=1e-5)
    assert network.weight.item() == 19


def test_averages_statistics_and_copies_counts() -> None:
    network = nn.BatchNorm2d(2)
    average = WeightAverage(network, 0.0)
    network(torch.randn(4, 2, 8, 8) + 3)
    average.update(network, 1)
    torch.testing.assert_close(average.network.running_mean, network.running_mean)
    assert int(average.network.num_batches_tracked) == 1


@pytest.mark.parametrize("name", ["cuda", "mps"])
def test_the_accelerators_generator_is_restored(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither is at hand here: a generator of the CPU stands in for it."""
    device, drawn = torch.device(name), torch.Generator().manual_seed(1)
    module = getattr(torch, name)
    monkeypatch.setattr(module, "get_rng_state", lambda _: drawn.get_state())
    monkeypatch.setattr(module, "set_rng_state", lambda state, _: drawn.set_state(state))
    method = Proposed(EFFICIENT)
    saved = random_state(method, device)
    expected = torch.rand(3, generator=drawn)
    load_random_state(method, device, SimpleNamespace(**saved))
    assert torch.equal(torch.rand(3, generator=drawn), expected)
    for other in (None, torch.zeros(16, dtype=torch.uint8)):  # from a CPU, and from another kind
        before = drawn.get_state()
        load_random_state(method, device, SimpleNamespace(**saved | {"device_rng": other}))
        assert torch.equal(drawn.get_state(), before)


def test_threads_are_given_or_saved_or_all_cores(tmp_path: Path) -> None:
    cores, count = usable_cores(), torch.get_num_threads()
    try:
        for threads, expected in ((1, 1), (None, cores)):
            set_threads(threads, tmp_path)
            assert torch.get_num_threads() == expected
        run = Run(EFFICIENT, Fabric(accelerator="cpu", devices=1), 1)
        for saved, expected in ((1, 1), (10_000, cores), (0, cores)):  # 0: not recorded
            run.state = replace(run.state, threads=saved)
            run.save(tmp_path / CHECKPOINT)
            set_threads(None, tmp_path)
            assert torch.get_num_threads() == expected
    finally:
        torch.set_num_threads(count)


@pytest.mark.parametrize("parts", [2, 3])
def test_gradients_of_a_batch_in_parts_are_those_of_the_whole(parts: int) -> None:
    random = torch.Generator().manual_seed(0)
    gray = torch.rand(4, 1, 32, 32, generator=random) * 2 - 1
    batch = TrainingBatch(gray, torch.rand(4, 1, 32, 32, generator=random) * 5 + 1)
    results = []
    for count in (1, parts):
        config = updated(PAPER, {**PLAIN, "optim": {"pool_size": 0, "accumulate": count}})
        run = Run(config, Fabric(accelerator="cpu", devices=1), 5)
        losses = run.step(batch)
        grads = {n: w.grad for n, w in run.method.named_parameters() if w.grad is not None}
        results.append((losses, grads))
    (whole_losses, whole), (losses, grads) = results
    assert losses == pytest.approx(whole_losses, rel=1e-5)
    assert grads.keys() == whole.keys()
    for name in [name for name in whole if whole[name].ndim > 1]:
        assert float((grads[name] - whole[name]).norm() / whole[name].norm()) < 1e-3, name


STORED = Path(__file__).parents[2] / "reference" / "training-seeds.json"
LIGHT = DataConfig(
    width=64,
    height=48,
    zoom=1.5,
    rotate_deg=5,
    colour_jitter=0.15,
    gamma=0.25,
    brightness=0.2,
    noise=0.03,
    cutmix=0.5,
)
SHOWN = {
    "light": LIGHT,
    "shapes": replace(LIGHT, aspects=(1.7778, 1.0, 0.75), turn=0.5, blur=0.7, border=0.6),
    "unpaired": replace(LIGHT, paired=False, cutmix=0.0),
    "originals": DataConfig(width=32, height=32, paired=False, crop_286=True, colour="luma"),
    "extra": replace(LIGHT, pseudo_label_share=0.25, turn=1.0),
}
TINY = {name: tiny(name) for name in PAPER_METHODS}
LEARNED = {
    **TINY,
    "proposed": replace(  # as it was stored, before the weights of the pilot
        TINY["proposed"], loss=replace(TINY["proposed"].loss, l1=10.0, l1_backward=False)
    ),
    "efficient": EFFICIENT,
    "averaged": replace(PAPER, optim=replace(PAPER.optim, ema=0.9, clip_norm=0.5)),
}


def _images() -> Rooms:
    """Images and depth by a formula, with holes in one of them."""
    rows, columns = np.mgrid[0:60, 0:80] / np.float32(80)
    numbers = np.arange(6, dtype=np.float32)[:, None, None]
    depths_m = 3 + np.sin(7 * columns + numbers) + np.cos(5 * rows * (numbers + 1))
    depths_m[3, 20:30, 10:50] = 0
    waves = [np.sin((numbers + 2) * (channel + 2) * (rows + columns)) for channel in range(3)]
    images = (127.5 + 100 * np.stack(waves, -1)).astype(np.uint8)
    return Rooms(images, np.float32(depths_m))


def _digest(values: torch.Tensor) -> list[float]:
    """Mean, spread, and means weighted by the place: across, down and in the batch."""
    values = values.double().cpu()
    digest = [values.mean(), values.std()]
    for axis in (0, 2, 3):
        shape = [-1 if i == axis else 1 for i in range(4)]
        digest.append((values * torch.linspace(-1, 1, values.shape[axis]).view(shape)).mean())
    return [round(float(value), 5) for value in digest]


def shown(name: str) -> dict[str, list[float]]:
    """Three batches of four pairs."""
    data, images = SHOWN[name], _images()
    store = PairStore(images, TRAIN, data)
    extra = PairStore(images, [2], data) if name == "extra" else None
    batches = batches_of(store, data, 4, 7, extra)
    return {
        f"{part} {step}": _digest(values)
        for step in (0, 1, 5)
        for part, values in zip(TrainingBatch._fields, batches[step], strict=True)
        if values is not None and values.ndim == 4
    }


def learned(name: str) -> dict[str, list[float]]:
    """Losses of two steps, one value of each, and the mean size of the weights."""
    config: TrainConfig = LEARNED[name]
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    run, losses = Run(config, Fabric(accelerator="cpu", devices=1), 2), dict[str, list[float]]()
    for step in range(2):
        run.state = replace(run.state, step=step)
        random = torch.Generator().manual_seed(step)
        gray = torch.rand(2, 1, 32, 32, generator=random) * 2 - 1
        depth_m = torch.rand(2, 1, 32, 32, generator=random) * 8 + 1
        for term, value in run.step(TrainingBatch(gray, depth_m)).items():
            losses.setdefault(term, []).append(float(f"{value:.6g}"))
    torch.set_num_threads(threads)
    for part, network in [*run.method.named_children(), ("best", run.ema_generator)]:
        sizes = [float(w.detach().abs().sum()) for w in network.parameters() if w.ndim > 1]
        losses[f"weights of {part}"] = [float(f"{sum(sizes):.6g}")]
    return losses


@pytest.mark.parametrize("name", SHOWN)
def test_a_seed_shows_the_same_views(name: str) -> None:
    expected, digests = json.loads(STORED.read_text())["shown"][name], shown(name)
    assert digests.keys() == expected.keys()
    for part, values in digests.items():
        assert values == pytest.approx(expected[part], abs=5e-5), part


@pytest.mark.parametrize("name", LEARNED)
def test_a_seed_learns_the_same(name: str) -> None:
    expected, digests = json.loads(STORED.read_text())["learned"][name], learned(name)
    assert digests.keys() == expected.keys()
    for part, values in digests.items():
        assert values[0] == pytest.approx(expected[part][0], rel=1e-3), part
        assert values == pytest.approx(expected[part], rel=1e-2), part  # as rounding errors grow


if __name__ == "__main__":
    content = {
        "shown": {name: shown(name) for name in SHOWN},
        "learned": {name: learned(name) for name in LEARNED},
    }
    lines = re.sub(r"\s+(?=[-\d\]])", " ", json.dumps(content, indent=1))
    STORED.write_text(lines + "\n", "utf-8")
    sys.stdout.write(f"{STORED}\n")
