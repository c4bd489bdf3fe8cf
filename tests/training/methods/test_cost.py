"""What a step at paper size computes, counted without computing it."""

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils.flop_counter import FlopCounterMode

from depthcli.training.config import updated
from depthcli.training.data import TrainingBatch
from depthcli.training.methods.registry import build_method, default_config
from depthcli.training.methods.table import PAPER_METHODS

TFLOP = {
    "cyclegan": 1.85,
    "cut": 1.41,
    "fastcut": 0.75,
    "dclgan": 2.27,
    "simdcl": 2.54,
    "hnegsrc": 1.41,
    "proposed": 2.28,
}
"""Forward and backward passes of one picture, 256 x 256, generators and discriminators."""


@pytest.mark.parametrize("name", PAPER_METHODS)
def test_a_step_makes_the_passes_of_its_formula_and_no_other(name: str) -> None:
    config = updated(default_config(name), {"loss": {"flip_contrast": False}})  # costs nothing
    with FakeTensorMode():
        method = build_method(config)
        batch = TrainingBatch(torch.zeros(1, 1, 256, 256), torch.ones(1, 1, 256, 256))
        with FlopCounterMode(display=False) as counter:
            for phase in method.phases:
                torch.stack(list(method(batch, phase).values())).sum().backward()
    assert counter.get_total_flops() / 1e12 == pytest.approx(TFLOP[name], abs=0.006)
