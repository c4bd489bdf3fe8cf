"""CycleGAN: its terms against plain loops, and the image pool."""

from typing import Any

import pytest
import torch
from helpers.tiny_methods import batch, coded, tiny_method
from torch import Tensor

from depthcli.lab.training.methods.cyclegan import ImagePool


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
    expected = {"adversarial": gan, "cycle": 10 * cycle, "identity": 5 * same}
    terms = method(batch(), "generator")
    assert terms.keys() == expected.keys()
    for name, value in expected.items():
        torch.testing.assert_close(terms[name], value)


def test_each_discriminator_judges_its_own_domain(method: Any) -> None:
    x, y = batch().network_input, coded(batch().depth_m)
    method(batch(), "generator")
    terms = method(batch(), "discriminator")
    pairs = {
        "depth_discriminator": (method.depth_discriminator, y, method.generator(x)),
        "gray_discriminator": (method.gray_discriminator, x, method.backward_generator(y)),
    }
    assert terms.keys() == pairs.keys()
    for name, (discriminator, real, fake) in pairs.items():
        torch.testing.assert_close(terms[name], _lsgan(discriminator(real), discriminator(fake)))


def _lsgan(real: Tensor, fake: Tensor) -> Tensor:
    return ((real - 1) ** 2).mean() / 2 + (fake**2).mean() / 2


def test_discriminators_are_shown_what_the_pool_gives_back(method: Any) -> None:
    """From the pool's first image on, every second fake or so is one of before."""
    past, sources = torch.full((1, 32, 32), 0.5), []
    for pool in method.pools:
        pool.size, pool.images = 1, [past]
    for seed in range(12):
        torch.manual_seed(seed)
        method(batch(), "generator")
        loss = method(batch(), "discriminator")["depth_discriminator"]
        y, fake_y = coded(batch().depth_m), method.generator(batch().network_input)
        discriminator = method.depth_discriminator
        losses = {
            "past": _lsgan(discriminator(y), discriminator(past[None])),
            "now": _lsgan(discriminator(y), discriminator(fake_y)),
        }
        sources += [name for name, value in losses.items() if torch.isclose(loss, value)]
        method.pools[1].images = [past]
    assert set(sources) == {"past", "now"}
    assert len(sources) == 12


def _image(value: float) -> Tensor:
    return torch.full((1, 1, 2, 2), float(value))


def test_half_of_the_time_swaps_for_a_stored_one() -> None:
    torch.manual_seed(0)
    pool, swapped, stored = ImagePool(4), 0, set(range(4))
    for value in range(4):
        pool.exchange(_image(value))
    for value in range(4, 404):
        out = int(pool.exchange(_image(value)).mean())
        assert out in stored | {value}
        if out != value:
            swapped += 1
            stored = stored - {out} | {value}
        assert {int(image.mean()) for image in pool.images} == stored
    assert 160 < swapped < 240
    assert not stored & set(range(4))  # every slot is swapped, sooner or later


def test_no_pool_hands_everything_through_detached() -> None:
    image = _image(1).requires_grad_()
    for size in (0, 2):
        out = ImagePool(size).exchange(image * 2)
        assert torch.equal(out, _image(2))
        assert not out.requires_grad


def test_stored_images_are_copies_of_one_image_each() -> None:
    batch = torch.arange(2.0).view(2, 1, 1, 1).expand(2, 1, 4, 4).clone()
    pool = ImagePool(5)
    pool.exchange(batch)
    batch.fill_(9)
    assert [tuple(image.shape) for image in pool.images] == [(1, 4, 4)] * 2
    assert [float(image.mean()) for image in pool.images] == [0, 1]


def test_images_of_two_sizes_stay_among_their_own() -> None:
    torch.manual_seed(0)
    pool, wide = ImagePool(4), torch.zeros(2, 1, 2, 4)
    fresh = set()
    for value in range(40):
        out = pool.exchange(torch.cat([_image(value), _image(value + 0.5)]))
        assert out.shape == (2, 1, 2, 2)
        assert pool.exchange(wide + value).shape == wide.shape
        fresh.add(float(out[0].mean()) == value)
    assert fresh == {True, False}
