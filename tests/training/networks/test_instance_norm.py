"""Instance norm against its formula in 64 bits, in every layout of memory."""

import itertools

import pytest
import torch

from depthcli.training.networks.layers import InstanceNorm

LAYOUTS = (torch.contiguous_format, torch.channels_last)


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("pictures", [1, 2])
@pytest.mark.parametrize(("layout", "of_gradient"), [*itertools.product(LAYOUTS, LAYOUTS)])
def test_outputs_and_gradients_are_those_of_the_formula(
    pictures: int, training: bool, layout: torch.memory_format, of_gradient: torch.memory_format
) -> None:
    torch.manual_seed(0)
    values = 3 * torch.randn(pictures, 4, 6, 5) + 2
    weights = torch.randn(pictures, 4, 6, 5)

    exact = values.double().requires_grad_()
    centred = exact - exact.mean((2, 3), keepdim=True)
    truth = centred / (centred.square().mean((2, 3), keepdim=True) + 1e-5).sqrt()
    truth.backward(weights.double())

    x = values.to(memory_format=layout).requires_grad_()
    layer = InstanceNorm(4).train(training)
    output = layer(x)
    output.backward(weights.to(memory_format=of_gradient))
    torch.testing.assert_close(output.double(), truth)
    torch.testing.assert_close(layer.eval()(x.detach()), output)
    assert x.grad is not None
    assert exact.grad is not None
    torch.testing.assert_close(x.grad.double(), exact.grad, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("pictures", [1, 2])
def test_no_running_statistics_are_kept(pictures: int) -> None:
    layer = InstanceNorm(4)
    layer(torch.randn(pictures, 4, 6, 5))
    assert not layer.state_dict()
