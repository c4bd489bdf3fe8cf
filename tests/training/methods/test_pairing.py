"""Which methods can tell which depth map belongs to a picture: the paper's own, and no other."""

from typing import Any

import pytest
import torch
from helpers.tiny_methods import batch, tiny, tiny_method
from torch import Tensor

from depthcli.errors import UsageError
from depthcli.training.config import updated
from depthcli.training.methods.registry import build_method, default_config
from depthcli.training.methods.table import METHODS
from depthcli.training.settings import apply_overrides

UNPAIRED = sorted(set(METHODS) - {"proposed"})


def _gradient(name: str, picture: int, depth: int, **loss: Any) -> Tensor:
    """What one step would move every weight by, for one of two pictures and depth maps."""
    method = tiny_method(name, **loss)
    seen = batch(picture)._replace(depth_m=batch(depth).depth_m)
    torch.manual_seed(5)
    for phase in method.phases:
        torch.stack(list(method(seen, phase).values())).sum().backward()
    return torch.cat([weight.grad.flatten() for weight in method.parameters()])


def _interaction(name: str, **loss: Any) -> float:
    """How much the gradient of a pair is more than a part of its picture and one of its depth.

    Where losses are sums of what looks at pictures and what looks at depth maps, exchanging the
    depth maps of two pairs leaves the sum of the two gradients as it was.
    """
    own = _gradient(name, 0, 0, **loss) + _gradient(name, 1, 1, **loss)
    exchanged = _gradient(name, 0, 1, **loss) + _gradient(name, 1, 0, **loss)
    return float((own - exchanged).norm() / own.norm())


# SimDCL's similarity compares a picture with a fake that is made of the depth map: it is defined
# across both lists, so that alone keeps it from pairs that they are drawn apart.
@pytest.mark.parametrize("name", UNPAIRED)
def test_exchanging_depth_maps_changes_nothing_for_an_unpaired_method(name: str) -> None:
    assert _interaction(name, **({"similarity": 0} if name == "simdcl" else {})) < 1e-5


def test_exchanging_depth_maps_changes_what_the_proposed_method_learns() -> None:
    assert _interaction("proposed") > 1e-4
    assert _interaction("proposed", l1=0) < 1e-5


@pytest.mark.parametrize("name", UNPAIRED)
def test_an_unpaired_method_is_never_shown_pairs(name: str) -> None:
    assert not default_config(name).data.paired
    config = apply_overrides(default_config(name), [], ["data.paired=true"])
    with pytest.raises(UsageError):
        build_method(config)


def test_the_proposed_method_learns_with_or_without_pairs() -> None:
    build_method(tiny("proposed"))
    without = updated(tiny("proposed", l1=0), {"data": {"paired": False}})
    build_method(without)
