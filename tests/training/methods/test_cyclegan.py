"""CycleGAN term by term, against the networks and losses it is made of."""

from typing import Any

import pytest
import torch
from helpers.tiny_methods import batch, coded, tiny_method
from torch import Tensor


@pytest.fixture
def method() -> Any:
    return tiny_method("cyclegan")


def test_generators_lose_both_gans_the_cycles_and_the_identities(method: Any) -> None:
    x, y = batch().network_input, coded(batch().depth_m)
    forward, backward = method.generator, method.backward_generator
    fake_y, fake_x = forward(x), backward(y)
    gan = ((method.depth_discriminator(fake_y) - 1) ** 2).mean()
    gan = gan + ((method.gray_discriminator(fake_x) - 1) ** 2).mean()
    cycle = (backward(fake_y) - x).abs().mean() + (forward(fake_x) - y).abs().mean()
    same = (forward(y) - y).abs().mean() + (backward(x) - x).abs().mean()
    wanted = {"adversarial": gan, "cycle": 10 * cycle, "identity": 5 * same}
    found = method(batch(), "generator")
    assert found.keys() == wanted.keys()
    for name, value in wanted.items():
        torch.testing.assert_close(found[name], value)


def test_each_discriminator_judges_its_own_domain(method: Any) -> None:
    x, y = batch().network_input, coded(batch().depth_m)
    method(batch(), "generator")
    found = method(batch(), "discriminator")
    pairs = {
        "depth_discriminator": (method.depth_discriminator, y, method.generator(x)),
        "gray_discriminator": (method.gray_discriminator, x, method.backward_generator(y)),
    }
    assert found.keys() == pairs.keys()
    for name, (discriminator, real, fake) in pairs.items():
        torch.testing.assert_close(found[name], _lsgan(discriminator(real), discriminator(fake)))


def _lsgan(real: Tensor, fake: Tensor) -> Tensor:
    return ((real - 1) ** 2).mean() / 2 + (fake**2).mean() / 2


def test_discriminators_are_shown_what_the_pool_gives_back(method: Any) -> None:
    """From the pool's first image on, every second fake or so is one of before."""
    past, seen = torch.full((1, 32, 32), 0.5), []
    for pool in method.pools:
        pool.size, pool.images = 1, [past]
    for seed in range(12):
        torch.manual_seed(seed)
        method(batch(), "generator")
        found = method(batch(), "discriminator")["depth_discriminator"]
        y, fake_y = coded(batch().depth_m), method.generator(batch().network_input)
        discriminator = method.depth_discriminator
        wanted = {
            "past": _lsgan(discriminator(y), discriminator(past[None])),
            "now": _lsgan(discriminator(y), discriminator(fake_y)),
        }
        seen += [name for name, value in wanted.items() if torch.isclose(found, value)]
        method.pools[1].images = [past]
    assert set(seen) == {"past", "now"}
    assert len(seen) == 12
