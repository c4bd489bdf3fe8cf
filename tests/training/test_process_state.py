"""The accelerator's generator of random numbers is continued, on CUDA and on MPS."""

import pytest
import torch
from helpers.rooms import EFFICIENT

from depthcli.training.methods.proposed import Proposed
from depthcli.training.run import load_process_state, process_state


@pytest.mark.parametrize("name", ["cuda", "mps"])
def test_the_accelerators_generator_is_saved_and_restored(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither is at hand here: a generator of the CPU stands in for it."""
    device, drawn = torch.device(name), torch.Generator().manual_seed(1)
    module = getattr(torch, name)
    monkeypatch.setattr(module, "get_rng_state", lambda _: drawn.get_state())
    monkeypatch.setattr(module, "set_rng_state", lambda state, _: drawn.set_state(state))
    method = Proposed(EFFICIENT)
    saved = process_state(method, device)
    wanted = torch.rand(3, generator=drawn)
    load_process_state(method, device, saved)
    assert torch.equal(torch.rand(3, generator=drawn), wanted)
    for other in (None, torch.zeros(16, dtype=torch.uint8)):  # from a CPU, and from another kind
        before = drawn.get_state()
        load_process_state(method, device, saved | {"device_rng": other})
        assert torch.equal(drawn.get_state(), before)
