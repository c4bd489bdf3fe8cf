"""A seed means the same as in the versions before: what a run is shown, and what it loses at first.

The stored values were computed when this test was written. Only a change that is meant to make all
seeds train otherwise may replace them: ``python tests/training/test_seeds.py``.
"""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.rooms import EFFICIENT, PAPER, TRAIN, Rooms
from helpers.tiny_methods import tiny
from lightning_fabric import Fabric

from depthcli.training.config import DataConfig, TrainConfig
from depthcli.training.data import Batches, PairStore, TrainingBatch
from depthcli.training.methods.table import PAPER_METHODS
from depthcli.training.run import Run

STORED = Path(__file__).parents[1] / "reference" / "training-seeds.json"
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


def _pictures() -> Rooms:
    """Pictures and depth by a formula, with holes in one of them."""
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
    found = [values.mean(), values.std()]
    for axis in (0, 2, 3):
        shape = [-1 if i == axis else 1 for i in range(4)]
        found.append((values * torch.linspace(-1, 1, values.shape[axis]).view(shape)).mean())
    return [round(float(value), 5) for value in found]


def shown(name: str) -> dict[str, list[float]]:
    """Three batches of four pairs."""
    data, pictures = SHOWN[name], _pictures()
    store = PairStore(pictures, TRAIN, data)
    extra = PairStore(pictures, [2], data) if name == "extra" else None
    batches = Batches(store, data, 4, 7, torch.device("cpu"), pseudo_labels=extra)
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


def _stored() -> dict[str, dict[str, Any]]:
    content: dict[str, dict[str, Any]] = json.loads(STORED.read_text("utf-8"))
    return content


@pytest.mark.parametrize("name", SHOWN)
def test_a_seed_shows_the_same_views(name: str) -> None:
    wanted, found = _stored()["shown"][name], shown(name)
    assert found.keys() == wanted.keys()
    for part, values in found.items():
        assert values == pytest.approx(wanted[part], abs=5e-5), part


@pytest.mark.parametrize("name", LEARNED)
def test_a_seed_learns_the_same(name: str) -> None:
    wanted, found = _stored()["learned"][name], learned(name)
    assert found.keys() == wanted.keys()
    for part, values in found.items():
        assert values[0] == pytest.approx(wanted[part][0], rel=1e-3), part
        assert values == pytest.approx(wanted[part], rel=1e-2), part  # as rounding errors grow


if __name__ == "__main__":
    content = {
        "shown": {name: shown(name) for name in SHOWN},
        "learned": {name: learned(name) for name in LEARNED},
    }
    lines = re.sub(r"\s+(?=[-\d\]])", " ", json.dumps(content, indent=1))
    STORED.write_text(lines + "\n", "utf-8")
    sys.stdout.write(f"{STORED}\n")
