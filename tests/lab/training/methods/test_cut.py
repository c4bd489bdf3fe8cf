"""CUT, FastCUT and HnegSRC term by term, against the networks and losses they are made of."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from helpers.seeded import seeded
from helpers.tiny_methods import batch, coded, phases, tiny, tiny_method
from lightning_fabric import Fabric
from torch import Tensor

from depthcli.lab.training.losses import hdce, patch_nce, semantic_relation
from depthcli.lab.training.methods.table import PAPER_METHODS
from depthcli.lab.training.run import Run


def contrast(
    method: Any, loss: Callable[..., Tensor], source: Tensor, output: Tensor, *, flipped: bool
) -> Tensor:
    keys, positions = method.sampler(method.generator.features(source))
    maps = method.generator.features(output)
    queries, _ = method.sampler([m.flip(3) for m in maps] if flipped else maps, positions)
    values = [loss(q, k) for q, k in zip(queries, keys, strict=True)]
    assert len(values) == 5
    return sum(values, torch.zeros(())) / 5


def test_cut_is_gan_and_half_of_either_contrast() -> None:
    method = tiny_method("cut")
    terms = phases(method)
    x, y = batch().network_input, coded(batch().depth_m)
    fake_y, same_y = method.generator(x), method.generator(y)
    discriminator = method.discriminator
    expected = ((discriminator(y) - 1) ** 2).mean() / 2 + (discriminator(fake_y) ** 2).mean() / 2
    torch.testing.assert_close(terms["discriminator"], expected)
    torch.testing.assert_close(terms["adversarial"], ((discriminator(fake_y) - 1) ** 2).mean())
    torch.manual_seed(5)
    nce_x = contrast(method, patch_nce, x, fake_y, flipped=False)
    nce_y = contrast(method, patch_nce, y, same_y, flipped=False)
    torch.testing.assert_close(terms["contrast_x"], nce_x / 2)
    torch.testing.assert_close(terms["contrast_y"], nce_y / 2)
    assert terms.keys() == {"discriminator", "adversarial", "contrast_x", "contrast_y"}


@pytest.mark.parametrize("flipped", [False, True])
def test_fastcut_mirrors_the_input_and_mirrors_the_features_back(flipped: bool) -> None:
    method, x = tiny_method("fastcut"), batch().network_input
    seed = next(
        s for s in range(99) if flipped == (float(torch.rand((), generator=seeded(s))) < 0.5)
    )
    terms = phases(method, seed)
    fake_y = method.generator(x.flip(3) if flipped else x)
    torch.testing.assert_close(
        terms["adversarial"], ((method.discriminator(fake_y) - 1) ** 2).mean()
    )
    torch.manual_seed(seed)
    torch.rand(())
    nce_x = contrast(method, patch_nce, x, fake_y, flipped=flipped)
    torch.testing.assert_close(terms["contrast_x"], 10 * nce_x)
    assert "contrast_y" not in terms


@pytest.mark.parametrize(("share_done", "gamma"), [(0.0, 50.0), (0.5, 30.0), (1.0, 10.0)])
def test_hnegsrc_hardens_its_negatives_over_the_schedule(share_done: float, gamma: float) -> None:
    method = tiny_method("hnegsrc")
    method.share_done = share_done
    terms = phases(method)
    x, y = batch().network_input, coded(batch().depth_m)

    def hard(query: Tensor, key: Tensor) -> Tensor:
        return hdce(query, key, gamma)

    torch.manual_seed(5)
    keys, positions = method.sampler(method.generator.features(x))
    queries, _ = method.sampler(method.generator.features(method.generator(x)), positions)
    pairs = list(zip(queries, keys, strict=True))
    contrast_x = sum(hard(q, k) for q, k in pairs) / 5
    torch.testing.assert_close(terms["contrast_x"], 0.05 * contrast_x)
    relation = sum(semantic_relation(q, k) for q, k in pairs) / 5
    torch.testing.assert_close(terms["relation"], 0.05 * relation)
    back = contrast(method, hard, y, method.generator(y), flipped=False)
    torch.testing.assert_close(terms["contrast_y"], 0.05 * back)


def test_hnegsrc_s_gamma_follows_the_steps_of_a_run() -> None:
    run = Run(tiny("hnegsrc"), Fabric(accelerator="cpu", devices=1), steps_per_epoch=2)
    gammas = []
    for step in range(run.steps):
        run.state = replace(run.state, step=step)
        run.step(batch())
        gammas.append(run.method.gamma)
    assert gammas == [50, 40, 30, 20]  # 10 would be the step after the last


@pytest.mark.parametrize("name", ["cut", "fastcut", "hnegsrc"])
def test_weight_of_zero_leaves_the_discriminator_out(name: str) -> None:
    method = tiny_method(name, adversarial=0)
    assert method.networks("discriminator") == []
    assert "adversarial" not in method(batch(), "generator")
    alone = tiny_method(name, contrast_x=0, contrast_y=0, relation=0)
    assert alone.networks("generator") == [alone.generator]
    assert set(alone(batch(), "generator")) == {"adversarial"}


@pytest.mark.parametrize("name", PAPER_METHODS)
def test_phases_move_their_own_networks_only(name: str) -> None:
    method = tiny_method(name)
    for phase in method.phases:
        method.zero_grad()
        sum(method(batch(), phase).values()).backward()
        for other in method.phases:
            grads = [w.grad for net in method.networks(other) for w in net.parameters()]
            assert any(g is not None and bool(g.any()) for g in grads) is (other == phase)
