"""Eq. 7 term by term, against the networks and losses it is made of."""

from dataclasses import replace
from typing import Any

import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from helpers import tiny_methods
from helpers.rooms import EFFICIENT, PAPER
from torch import Tensor

from depthcli.lab.training.config import LossConfig
from depthcli.lab.training.data import TrainingBatch
from depthcli.lab.training.losses import cfl_nce, conv_weights, patch_nce
from depthcli.lab.training.methods.base import generate
from depthcli.lab.training.methods.proposed import Proposed

NOTHING = LossConfig(0, 0, 0, 0, 0, 0, 0, 0)
ALONE = {
    "adversarial": ("adversarial", "depth_discriminator", "gray_discriminator"),
    "contrast_x": ("contrast_x",),
    "contrast_y": ("contrast_y",),
    "identity": ("identity",),
    "cycle": ("cycle",),
    "l1": ("l1",),
    "gradient": ("gradient",),
}


def _method(**loss: Any) -> Proposed:
    torch.manual_seed(1)
    return Proposed(replace(PAPER, loss=replace(NOTHING, **loss)))


def _terms(method: Proposed, batch: TrainingBatch) -> dict[str, Tensor]:
    return method(batch, "generator") | method(batch, "discriminator")


@pytest.mark.parametrize("name", ALONE)
def test_weight_of_zero_leaves_term_and_networks_out(name: str) -> None:
    method = _method(**{name: 1.0})
    assert set(_terms(method, tiny_methods.batch())) == set(ALONE[name])
    assert (method.sampler is not None) == name.startswith("contrast")
    assert (method.depth_discriminator is not None) == (name == "adversarial")
    backward = name in {"adversarial", "identity", "cycle"}
    assert (method.backward_generator is not None) == backward


def test_cycle_and_identity_are_equations_2_and_3() -> None:
    method, batch = _method(cycle=1.0, identity=1.0), tiny_methods.batch()
    forward, backward = method.generator, method.backward_generator
    x, y = batch.network_input, (batch.depth_m - 5) / 5
    terms = method(batch, "generator")
    cycle = (backward(forward(x)) - x).abs().mean() + (forward(backward(y)) - y).abs().mean()
    torch.testing.assert_close(terms["cycle"], cycle)
    identity = (forward(y) - y).abs().mean() + (backward(x) - x).abs().mean()
    torch.testing.assert_close(terms["identity"], identity)


@pytest.mark.parametrize("both", [False, True])
def test_l1_is_equation_1_on_one_or_both_generators(both: bool) -> None:
    method, batch = _method(l1=2.0, weight_penalty=0.01, l1_backward=both), tiny_methods.batch()
    x, y = batch.network_input, (batch.depth_m - 5) / 5
    terms = method(batch, "generator")
    assert set(terms) == {"l1", "l1_backward"} if both else {"l1"}
    pairs = {"l1": (method.generator, x, y), "l1_backward": (method.backward_generator, y, x)}
    for name, value in terms.items():
        network, source, truth = pairs[name]
        penalty = 0.01 * sum((w.detach() ** 2).sum().item() for w in conv_weights(network))
        expected = 2 * ((network(source) - truth).abs().mean().item() + penalty)
        assert value.item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", ["contrast_x", "contrast_y"])
@pytest.mark.parametrize("contrast", ["cut", "cfl"])
def test_contrast_is_equation_4_over_taps_at_the_same_positions(contrast: str, name: str) -> None:
    """Of depth y, output is compared with input: the truth of G(y) is y itself."""
    method, batch = _method(**{name: 0.5}, contrast=contrast), tiny_methods.batch()
    torch.manual_seed(5)
    value = method(batch, "generator")[name]
    generator, sampler = method.generator, method.sampler
    assert sampler is not None
    x, y = batch.network_input, (batch.depth_m - 5) / 5
    is_paired = name == "contrast_x" and contrast == "cfl"
    translated_from = x if name == "contrast_x" else y
    source, loss = (y, cfl_nce) if is_paired else (translated_from, patch_nce)
    torch.manual_seed(5)
    keys, positions = sampler(generator.features(source))
    queries, _ = sampler(generator.features(generator(translated_from)), positions)
    losses = [loss(q, k) for q, k in zip(queries, keys, strict=True)]
    assert len(losses) == 5
    torch.testing.assert_close(value, 0.5 * sum(losses) / 5)


@pytest.mark.parametrize("cycle", [0.0, 1.0])
def test_one_direction_judges_depth_alone(cycle: float) -> None:
    method = _method(adversarial=2.0, adversarial_backward=False, cycle=cycle)
    x, y = tiny_methods.batch().network_input, (tiny_methods.batch().depth_m - 5) / 5
    terms, discriminator = _terms(method, tiny_methods.batch()), method.depth_discriminator
    assert discriminator is not None
    assert (method.backward_generator is None) == (not cycle)
    assert method.networks("discriminator") == [discriminator]
    assert set(terms) == {"adversarial", "depth_discriminator"} | ({"cycle"} if cycle else set())
    fake = discriminator(method.generator(x))
    torch.testing.assert_close(terms["adversarial"], 2 * ((fake - 1) ** 2).mean())
    expected = ((discriminator(y) - 1) ** 2).mean() / 2 + (fake**2).mean() / 2
    torch.testing.assert_close(terms["depth_discriminator"], expected)
    assert {name: len(images) for name, images in method.extra_state().items()} == {
        "pool_gray": 0,
        "pool_depth": 1,
    }


def test_depth_beyond_the_coding_is_clamped() -> None:
    method = _method(l1=1.0)
    coded = method.encode(torch.tensor([0.0, 5.0, 10.0, 80.0]))
    torch.testing.assert_close(coded, torch.tensor([-1.0, 0.0, 1.0, 1.0]))
    log = Proposed(EFFICIENT)
    coded = log.encode(torch.tensor([0.0, 0.4, 2.0, 10.0, 80.0]))
    torch.testing.assert_close(coded, torch.tensor([-1.0, -1.0, 0.0, 1.0, 1.0]))


def test_output_at_half_the_size_is_held_to_the_mean_of_the_truth() -> None:
    config = replace(EFFICIENT, loss=replace(NOTHING, l1=1.0))
    method, batch = Proposed(config), tiny_methods.batch()
    torch.nn.init.normal_(method.eval().generator.head.weight)
    raw, y = method.generator(batch.network_input), method.encode(batch.depth_m)
    expected = (raw - F.avg_pool2d(y, 2)).abs().mean()
    torch.testing.assert_close(method(batch, "generator")["l1"], expected)


@pytest.mark.parametrize("config", [PAPER, EFFICIENT], ids=["resnet", "efficient"])
def test_pixels_in_holes_are_not_learned(config: Any) -> None:
    """The terms against the truth are of measured pixels alone, at the output's size."""
    loss = replace(NOTHING, l1=1.0, gradient=1.0, l1_backward=True)
    method, plain = Proposed(replace(config, loss=loss)).eval(), tiny_methods.batch()
    for weight in method.generator.get_submodule("head").parameters():
        torch.nn.init.normal_(weight, std=0.1)
    valid_mask = torch.ones(1, 1, 32, 32, dtype=torch.bool)
    valid_mask[..., 3:14, 5:20] = False
    values = []
    for filled_m in (2.0, 9.0):
        depth_m = torch.where(valid_mask, plain.depth_m, torch.full_like(plain.depth_m, filled_m))
        holed = plain._replace(depth_m=depth_m, valid_mask=valid_mask)
        whole = plain._replace(depth_m=depth_m)
        values.append([method(b, "generator") for b in (holed, whole)])
    for name in ("l1", "gradient"):
        (holed, whole), (other_holed, other_whole) = ([t[name] for t in v] for v in values)
        torch.testing.assert_close(holed, other_holed)
        assert abs((whole - other_whole).item()) > 1e-3
    raw = method.generator(plain.network_input)
    step = 32 // raw.shape[2]
    valid = valid_mask[..., ::step, ::step] & valid_mask[..., step - 1 :: step, step - 1 :: step]
    truth = F.avg_pool2d(method.encode(plain.depth_m), step)
    torch.testing.assert_close(values[0][0]["l1"], (raw - truth).abs()[valid].mean())


@pytest.mark.parametrize("config", [PAPER, EFFICIENT], ids=["resnet", "efficient"])
def test_backward_l1_is_of_measured_pixels_alone(config: Any) -> None:
    loss = replace(NOTHING, l1=2.0, l1_backward=True)
    method, plain = Proposed(replace(config, loss=loss)).eval(), tiny_methods.batch()
    backward = method.backward_generator
    for weight in backward.get_submodule("head").parameters():
        torch.nn.init.normal_(weight, std=0.1)
    valid_mask = torch.rand(1, 1, 32, 32, generator=torch.Generator().manual_seed(3)) < 0.6
    error = (generate(backward, method.encode(plain.depth_m)) - plain.network_input).abs()
    l1 = method(plain._replace(valid_mask=valid_mask), "generator")["l1_backward"]
    torch.testing.assert_close(l1, 2 * error[valid_mask].mean())
    assert abs((error[valid_mask].mean() - error.mean()).item()) > 1e-3
