"""DCLGAN and SimDCL term by term, against the networks and losses they are made of."""

from typing import Any

import pytest
import torch
from helpers.tiny_methods import batch, coded, phases, tiny, tiny_method
from torch import Tensor

from depthcli.lab.training.losses import patch_nce
from depthcli.lab.training.methods.registry import build_method
from depthcli.lab.training.run import build_optimizer

TAPS = ("down1", "down2", "block1", "block5")


def vectors(method: Any) -> tuple[list[Tensor], ...]:
    """Keys of x, queries of G(x), keys of y, queries of F(y)."""
    forward, backward = method.generator, method.backward_generator
    x, y = batch().network_input, coded(batch().depth_m)
    torch.manual_seed(5)
    key_x, at_x = method.sampler_gray(forward.features(x, TAPS))
    key_y, at_y = method.sampler_depth(backward.features(y, TAPS))
    query_y, _ = method.sampler_depth(backward.features(forward(x), TAPS), at_x)
    query_x, _ = method.sampler_gray(forward.features(backward(y), TAPS), at_y)
    return key_x, query_y, key_y, query_x


@pytest.mark.parametrize(("name", "weight"), [("dclgan", 1.0), ("simdcl", 0.5)])
def test_contrast_crosses_the_encoders(name: str, weight: float) -> None:
    method = tiny_method(name)
    terms = phases(method)
    key_x, query_y, key_y, query_x = vectors(method)
    there = [patch_nce(q, k) for q, k in zip(query_y, key_x, strict=True)]
    back = [patch_nce(q, k) for q, k in zip(query_x, key_y, strict=True)]
    assert len(there) == len(back) == 4
    torch.testing.assert_close(terms["contrast_x"], weight * sum(there) / 4)
    torch.testing.assert_close(terms["contrast_y"], weight * sum(back) / 4)


@pytest.mark.parametrize("name", ["dclgan", "simdcl"])
def test_gans_are_hinge_and_half_of_each_counts(name: str) -> None:
    method = tiny_method(name)
    terms = phases(method)
    forward, backward = method.generator, method.backward_generator
    x, y = batch().network_input, coded(batch().depth_m)
    fake = {"depth_discriminator": forward(x), "gray_discriminator": backward(y)}
    real = {"depth_discriminator": y, "gray_discriminator": x}
    deceived = torch.zeros(())
    for role, output in fake.items():
        discriminator = getattr(method, role)
        margins = (
            (1 - discriminator(real[role])).relu().mean(),
            (1 + discriminator(output)).relu().mean(),
        )
        torch.testing.assert_close(terms[role], sum(margins) / 2)
        deceived = deceived + (1 - discriminator(output)).relu().mean()
    torch.testing.assert_close(terms["adversarial"], deceived / 2)
    same = (forward(y) - y).abs().mean() + (backward(x) - x).abs().mean()
    torch.testing.assert_close(terms["identity"], same / 2)


def test_simdcl_compares_one_vector_an_image_and_domain() -> None:
    method = tiny_method("simdcl")
    value = phases(method)["similarity"]
    real_x, at_positions_of_x, real_y, _ = vectors(method)
    x, y = batch().network_input, coded(batch().depth_m)
    fake_x, _ = method.sampler_gray(method.generator.features(method.backward_generator(y), TAPS))
    fake_y, _ = method.sampler_depth(method.backward_generator.features(method.generator(x), TAPS))
    assert not torch.equal(fake_y[0], at_positions_of_x[0])  # theirs are drawn anew
    gray = (method.map_real_x(real_x) - method.map_fake_x(fake_x)).abs().mean()
    depth = (method.map_real_y(real_y) - method.map_fake_y(fake_y)).abs().mean()
    torch.testing.assert_close(value, 10 * (gray + depth))
    size = sum(w.numel() for w in method.map_real_x.parameters())
    assert size == 10_688


@pytest.mark.parametrize(
    ("left", "networks"),
    [
        ("adversarial", {"depth_discriminator", "gray_discriminator"}),
        ("identity", set()),
        ("contrast_x", {"sampler_gray", "sampler_depth"}),
        ("contrast_y", {"sampler_gray", "sampler_depth"}),
        ("similarity", None),
    ],
)
def test_weight_of_zero_leaves_term_and_networks_out(left: str, networks: set[str] | None) -> None:
    nothing = dict.fromkeys(("adversarial", "identity", "contrast_x", "contrast_y"), 0.0)
    method = tiny_method("simdcl", **nothing | {"similarity": 0.0} | {left: 1.0})
    of_generator = set(method(batch(), "generator"))
    assert of_generator == {left}
    built = {name for name, _ in method.named_children()} - {"generator", "backward_generator"}
    if networks is not None:
        assert built == networks
    else:
        assert len(built) == 6  # the heads and the four maps
    assert bool(method.networks("discriminator")) == (left == "adversarial")


@pytest.mark.parametrize(
    ("name", "of_heads"), [("dclgan", (1e-3, (0.9, 0.999))), ("simdcl", (2e-4, (0.5, 0.999)))]
)
def test_only_dclgan_s_heads_have_a_rate_of_their_own(
    name: str, of_heads: tuple[float, tuple[float, float]]
) -> None:
    method = build_method(tiny(name))
    groups = build_optimizer(method, "generator", method.config.optim).param_groups
    heads = {id(w) for head in method.heads() for w in head.parameters()}
    assert heads
    for group in groups:
        mine = {id(w) for w in group["params"]}
        rate = (group["lr"], group["betas"])
        assert rate == (of_heads if mine & heads else (2e-4, (0.5, 0.999)))
    owned = {id(w) for net in method.networks("generator") for w in net.parameters()}
    assert {id(w) for group in groups for w in group["params"]} == owned
