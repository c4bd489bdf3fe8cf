"""The gate: it measures what it says, and nothing wrong passes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.small import small_network
from helpers.tiny import tiny_onnx
from torch import Tensor, nn

from depthcli.errors import ParityError
from depthcli.export.graph import _inputs, build_graph, check_parity

CASES = ((1, 12, 16), (2, 24, 8))


class _Offset(nn.Module):
    """The tiny model, whose output is its input, and something that it does not do."""

    def __init__(self, offset: float) -> None:
        super().__init__()
        self.offset = offset

    def forward(self, x: Tensor) -> Tensor:
        return x + self.offset


class _SizeBakedIn(nn.Module):
    """Tracing fixes what is computed outside torch, so the export is right at one size only."""

    def forward(self, x: Tensor) -> Tensor:
        return x * (float(x.shape[3]) / 128)


class _FirstImageOnly(nn.Module):
    """Wrong for the second picture of a batch alone."""

    def forward(self, x: Tensor) -> Tensor:
        return torch.cat([x[:1], x[1:] + 0.5])


def test_same_network_passes_and_is_measured() -> None:
    network = small_network()
    parity = check_parity(network, build_graph(network).SerializeToString(), ((1, 32, 48),))
    assert 0 < parity.mean_abs < parity.max_abs < 1e-3
    assert parity.cases == ((1, 32, 48),)


def test_difference_is_the_true_difference() -> None:
    parity = check_parity(_Offset(0.25), tiny_onnx(), CASES, tolerance=0.3)
    assert parity.max_abs == pytest.approx(0.25, abs=1e-6)
    assert parity.mean_abs == pytest.approx(0.25, abs=1e-6)


def test_difference_within_the_tolerance_passes() -> None:
    largest = check_parity(_Offset(0.25), tiny_onnx(), CASES, tolerance=1).max_abs
    assert check_parity(_Offset(0.25), tiny_onnx(), CASES, largest).tolerance == largest


@pytest.mark.parametrize("size", [(1, 24, 32), (3, 33, 35)])
def test_inputs_take_up_the_range_of_pictures(size: tuple[int, int, int]) -> None:
    noise, ramp, waves = inputs = _inputs(*size, 1)
    batch, height, width = size
    for picture in inputs:
        assert (picture.shape, picture.dtype) == ((batch, 1, height, width), np.float32)
        assert picture.flags.c_contiguous
        assert 0.9 < picture.max() <= 1
        assert -1 <= picture.min() < 0
        assert picture.std() > 0.2
    assert len(np.unique(noise)) == noise.size
    assert abs(noise.mean()) < 0.3
    for one in ramp[:, 0]:
        np.testing.assert_allclose(one[0], np.linspace(-1, 1, width), atol=1e-6)
        assert [row.tolist() == one[0].tolist() for row in one] == [
            row < height // 2 for row in range(height)
        ]
    assert (waves == waves[:1]).all()


@pytest.mark.parametrize(
    "network",
    [_Offset(0.002), _Offset(float("nan")), _FirstImageOnly(), nn.MaxPool2d(3, 1, 1)],
    ids=["offset", "nan", "second of a batch", "another network"],
)
def test_wrong_network_is_refused(network: nn.Module) -> None:
    with pytest.raises(ParityError):
        check_parity(network, tiny_onnx(), CASES)


def test_size_that_tracing_fixed_is_noticed() -> None:
    network = _SizeBakedIn()
    model = build_graph(network).SerializeToString()
    check_parity(network, model, ((2, 96, 128),))
    with pytest.raises(ParityError):
        check_parity(network, model, ((1, 96, 120),))
