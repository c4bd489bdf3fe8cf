"""The adversarial terms against plain loops, and what they say of known discriminators."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from depthcli.training.losses import discriminator_loss, generator_loss

FORMS = ("lsgan", "hinge", "ralsgan")


@pytest.fixture
def outputs() -> tuple[Tensor, Tensor]:
    """Real and fake outputs of a discriminator, of different sizes so that none is mixed up."""
    generator = torch.Generator().manual_seed(1)
    real = torch.randn(2, 1, 5, 4, generator=generator)
    return real, 2 * torch.randn(2, 1, 3, 6, generator=generator) - 0.5


def _loss(loss: Callable[..., Tensor], gan: str, outputs: tuple[Tensor, Tensor]) -> Tensor:
    return loss(gan, nn.Identity(), real=outputs[0], fake=outputs[1])


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)


def test_lsgan_is_its_formula(outputs: tuple[Tensor, Tensor]) -> None:
    real, fake = (o.flatten().tolist() for o in outputs)
    wanted = 0.5 * (_mean([(r - 1) ** 2 for r in real]) + _mean([f**2 for f in fake]))
    assert _loss(discriminator_loss, "lsgan", outputs).item() == pytest.approx(wanted, rel=1e-5)
    wanted = _mean([(f - 1) ** 2 for f in fake])
    assert _loss(generator_loss, "lsgan", outputs).item() == pytest.approx(wanted, rel=1e-5)


def test_hinge_is_its_formula(outputs: tuple[Tensor, Tensor]) -> None:
    real, fake = (o.flatten().tolist() for o in outputs)
    wanted = 0.5 * (_mean([max(0, 1 - r) for r in real]) + _mean([max(0, 1 + f) for f in fake]))
    assert _loss(discriminator_loss, "hinge", outputs).item() == pytest.approx(wanted, rel=1e-5)
    wanted = _mean([max(0, 1 - f) for f in fake])
    assert _loss(generator_loss, "hinge", outputs).item() == pytest.approx(wanted, rel=1e-5)


def test_ralsgan_is_its_formula(outputs: tuple[Tensor, Tensor]) -> None:
    real, fake = (o.flatten().tolist() for o in outputs)
    mean_real, mean_fake = _mean(real), _mean(fake)

    def relative(to_fake: float, to_real: float) -> float:
        high = _mean([(r - mean_fake - to_fake) ** 2 for r in real])
        return 0.5 * (high + _mean([(f - mean_real - to_real) ** 2 for f in fake]))

    assert _loss(discriminator_loss, "ralsgan", outputs).item() == pytest.approx(
        relative(1, -1), rel=1e-5
    )
    assert _loss(generator_loss, "ralsgan", outputs).item() == pytest.approx(
        relative(-1, 1), rel=1e-5
    )


class _Judge(nn.Module):
    """Says of every patch the mean of its image, so that the verdict is known."""

    def __init__(self) -> None:
        super().__init__()
        self.gain = nn.Parameter(torch.ones(()))

    def forward(self, image: Tensor) -> Tensor:
        return self.gain * nn.functional.avg_pool2d(image, 4)


@pytest.mark.parametrize(
    ("gan", "real_value", "fake_value"), [("lsgan", 1, 0), ("hinge", 1, -1), ("ralsgan", 0.5, -0.5)]
)
def test_right_discriminator_loses_nothing(gan: str, real_value: float, fake_value: float) -> None:
    real = torch.full((1, 1, 8, 8), float(real_value))
    fake = torch.full((1, 1, 8, 8), float(fake_value))
    assert discriminator_loss(gan, _Judge(), real=real, fake=fake).item() == 0
    assert generator_loss(gan, _Judge(), real=real, fake=fake).item() > 0.9


@pytest.mark.parametrize("gan", FORMS)
def test_generator_moves_the_fake_towards_the_real(gan: str) -> None:
    real, fake = torch.ones(1, 1, 8, 8), torch.zeros(1, 1, 8, 8, requires_grad=True)
    generator_loss(gan, _Judge(), real=real, fake=fake).backward()
    assert fake.grad is not None
    assert bool((fake.grad < 0).all())


@pytest.mark.parametrize("gan", FORMS)
def test_outputs_are_judged_in_full_precision(gan: str) -> None:
    image = torch.linspace(-1, 1, 64).reshape(1, 1, 8, 8)
    with torch.autocast("cpu", torch.bfloat16):
        discriminator = nn.Conv2d(1, 1, 4)
        loss = generator_loss(gan, discriminator, real=image, fake=-image)
        assert discriminator(image).dtype == torch.bfloat16
    assert loss.dtype == torch.float32
    assert np.isfinite(loss.item())
