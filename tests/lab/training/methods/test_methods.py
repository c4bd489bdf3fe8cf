"""All methods: what they share, and what each costs."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.rooms import rooms
from helpers.runs import same
from helpers.supervised_runs import train_steps
from helpers.tiny import load
from helpers.tiny_methods import batch, tiny, tiny_method
from torch import Tensor

from depthcli.core.options import Upsampling, UpsamplingOptions
from depthcli.core.types import DepthKind, Frame
from depthcli.errors import UsageError
from depthcli.inference.transforms import prepare
from depthcli.lab.export.onnx import ExportOptions, export_checkpoint
from depthcli.lab.training.checkpoint import CHECKPOINT, Checkpoint, load_generator
from depthcli.lab.training.config import LossConfig, TrainConfig, updated
from depthcli.lab.training.methods.base import TwoWay
from depthcli.lab.training.methods.registry import (
    build_method,
    check_terms,
    default_config,
    method_class,
)
from depthcli.lab.training.methods.table import PAPER_METHODS
from depthcli.lab.training.settings import apply_overrides


@pytest.mark.parametrize("name", PAPER_METHODS)
def test_method_learns_saves_and_resumes_bit_exactly(tmp_path: Path, name: str) -> None:
    config = tiny(name)
    assert train_steps(config, tmp_path / "broken").step == 2
    first = Checkpoint.load(tmp_path / "broken" / CHECKPOINT)
    fresh = build_method(config).state_dict()
    assert first.method.keys() == fresh.keys()
    assert train_steps(config, tmp_path / "broken").step == 4
    assert train_steps(config, tmp_path / "whole", steps=4).step == 4
    broken, whole = (Checkpoint.load(tmp_path / run / CHECKPOINT) for run in ("broken", "whole"))
    for part in ("method", "extra", "rng"):
        assert same(getattr(broken, part), getattr(whole, part)), part
    moved = {n for n in fresh if not torch.equal(first.method[n], broken.method[n])}
    phases = {n.partition(".")[0] for n in fresh}
    assert {n.partition(".")[0] for n in moved} == phases  # every network learns


@pytest.mark.parametrize("name", PAPER_METHODS)
def test_method_trains_on_colour_exports_and_predicts(tmp_path: Path, name: str) -> None:
    config = updated(tiny(name), {"data": {"colour": "rgb"}})
    assert train_steps(config, tmp_path).step == 2
    done = export_checkpoint(tmp_path / CHECKPOINT, tmp_path / "model.onnx", ExportOptions())
    assert done.card.training["method"] == name
    bilinear = UpsamplingOptions(Upsampling.BILINEAR)
    pipeline = load(tmp_path / "model.onnx", provider="cpu", detail=bilinear)
    frame = Frame(rooms().image(0))
    depth = pipeline.predict(frame).depth
    assert depth.kind is DepthKind.METRIC
    assert depth.values.shape == (frame.height, frame.width)
    generator, checkpoint = load_generator(tmp_path / CHECKPOINT)
    image = torch.from_numpy(prepare(pipeline.card.input, frame)[0])
    method = build_method(checkpoint.config)
    method.load_state_dict(checkpoint.method)
    with torch.no_grad():
        raw = generator(image)
        assert torch.equal(raw, method.generator.eval()(image))  # G, never F beside it
        assert not torch.equal(raw, generator(image.flip(1)))
    wanted_m = checkpoint.config.output.codec.decode(raw.numpy())
    assert float(np.mean(depth.values)) == pytest.approx(float(wanted_m.mean()), rel=0.01)
    np.testing.assert_allclose(pipeline.session.run(image.numpy()), raw[:, 0], atol=1e-4)
    if isinstance(method, TwoWay) and method.backward_generator:
        assert method.backward_generator(image).shape == image.shape


UNPAIRED_METHODS = sorted(set(PAPER_METHODS) - {"proposed"})


def _gradient(name: str, image: int, depth: int, **loss: Any) -> Tensor:
    """What one step would move every weight by, for one of two images and depth maps."""
    method = tiny_method(name, **loss)
    pair = batch(image)._replace(depth_m=batch(depth).depth_m)
    torch.manual_seed(5)
    for phase in method.phases:
        torch.stack(list(method(pair, phase).values())).sum().backward()
    return torch.cat([weight.grad.flatten() for weight in method.parameters()])


def _interaction(name: str, **loss: Any) -> float:
    """How much the gradient of a pair is more than a part of its image and one of its depth.

    Where losses are sums of what looks at images and what looks at depth maps, exchanging the
    depth maps of two pairs leaves the sum of the two gradients as it was.
    """
    paired = _gradient(name, 0, 0, **loss) + _gradient(name, 1, 1, **loss)
    exchanged = _gradient(name, 0, 1, **loss) + _gradient(name, 1, 0, **loss)
    return float((paired - exchanged).norm() / paired.norm())


# SimDCL's similarity compares an image with a fake that is made of the depth map: it is defined
# across both lists, so that alone keeps it from pairs that they are drawn apart.
@pytest.mark.parametrize("name", UNPAIRED_METHODS)
def test_exchanging_depth_maps_changes_nothing_for_an_unpaired_method(name: str) -> None:
    assert _interaction(name, **({"similarity": 0} if name == "simdcl" else {})) < 1e-5


def test_exchanging_depth_maps_changes_what_the_proposed_method_learns() -> None:
    assert _interaction("proposed") > 1e-4
    assert _interaction("proposed", l1=0) < 1e-5


@pytest.mark.parametrize("name", UNPAIRED_METHODS)
def test_an_unpaired_method_is_never_shown_pairs(name: str) -> None:
    assert not default_config(name).data.paired
    config = apply_overrides(default_config(name), [], ["data.paired=true"])
    with pytest.raises(UsageError):
        build_method(config)


UNPAIRED = ("cyclegan", "cut", "fastcut", "dclgan", "simdcl", "hnegsrc")
WEIGHTS = {
    "cyclegan": {"adversarial": 1, "cycle": 10, "identity": 5},
    "cut": {"adversarial": 1, "contrast_x": 0.5, "contrast_y": 0.5},
    "fastcut": {"adversarial": 1, "contrast_x": 10},
    "dclgan": {"adversarial": 0.5, "contrast_x": 1, "contrast_y": 1, "identity": 0.5},
    "simdcl": {
        "adversarial": 0.5,
        "contrast_x": 0.5,
        "contrast_y": 0.5,
        "identity": 0.5,
        "similarity": 10,
    },
    "hnegsrc": {"adversarial": 1, "contrast_x": 0.05, "contrast_y": 0.05, "relation": 0.05},
    "proposed": {
        "adversarial": 1,
        "contrast_x": 0.5,
        "contrast_y": 0.5,
        "identity": 5,
        "cycle": 10,
        "l1": 100,
    },
}
SCHEDULES = {
    "cyclegan": (100, 100, 50),
    "cut": (200, 200, 0),
    "fastcut": (150, 50, 0),
    "dclgan": (200, 200, 0),
    "simdcl": (200, 200, 0),
    "hnegsrc": (200, 200, 0),
    "proposed": (100, 100, 50),
}


@pytest.mark.parametrize("name", PAPER_METHODS)
def test_weights_schedules_and_half_steps_are_the_published_ones(name: str) -> None:
    config = default_config(name)
    loss, optim, terms = config.loss, config.optim, method_class(name).TERMS
    assert {term: w for term in terms if (w := getattr(loss, term))} == WEIGHTS[name]
    assert loss.gan == ("hinge" if name in {"dclgan", "simdcl"} else "lsgan")
    assert loss.flip_contrast == (name == "fastcut")
    phases = build_method(tiny(name)).phases
    assert sorted(phases, reverse=name in {"cyclegan", "proposed"}) == [*phases]
    assert (optim.epochs_constant, optim.epochs_decay, optim.pool_size) == SCHEDULES[name]
    assert (optim.learning_rate, optim.beta1, optim.beta2) == (2e-4, 0.5, 0.999)
    assert optim.batch_size == 1
    heads = (optim.head_learning_rate, optim.head_beta1, optim.head_beta2)
    assert heads == ((1e-3, 0.9, 0.999) if name == "dclgan" else (0, 0.5, 0.999))
    assert config.data.paired == (name not in UNPAIRED)
    assert config.generator.antialias == (name not in {"cyclegan", "proposed"})
    assert config.generator.residual == ("stem" if name == "proposed" else "none")


@pytest.mark.parametrize("name", PAPER_METHODS)
def test_a_loss_that_the_method_has_not_is_refused(name: str) -> None:
    supported = set(WEIGHTS["cut" if name == "fastcut" else name])
    supported |= {"gradient"} if name == "proposed" else set()
    for term in sorted({"gradient"}.union(*WEIGHTS.values())):
        loss = replace(default_config(name).loss, **{term: 2.0})
        config = replace(default_config(name), loss=loss)
        if term in supported:
            check_terms(config)
            continue
        with pytest.raises(UsageError):
            check_terms(config)


@pytest.mark.parametrize("name", PAPER_METHODS)
def test_a_run_without_any_loss_is_refused(name: str) -> None:
    nothing = LossConfig(0, 0, 0, 0, 0, 0, 0, 0)
    with pytest.raises(UsageError):
        build_method(replace(TrainConfig(method=name), loss=nothing))
