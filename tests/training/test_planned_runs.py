"""Where several runs live, and how they share a budget."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from helpers.rooms import EFFICIENT, room_data
from hypothesis import given
from hypothesis import strategies as st
from lightning_fabric import Fabric

from depthcli.errors import CheckpointError
from depthcli.training.callbacks import Callback
from depthcli.training.loop import Limits, fit
from depthcli.training.provenance import PlannedRun, fair_shares_s, next_share_s

if TYPE_CHECKING:
    from pathlib import Path

_SPENT = st.lists(st.floats(0, 1e5), min_size=1, max_size=8)


@given(spent_s=_SPENT, budget_s=st.floats(0, 1e6))
def test_shares_are_the_budget_and_level_those_who_had_least(
    spent_s: list[float], budget_s: float
) -> None:
    shares_s = fair_shares_s(spent_s, budget_s)
    assert min(shares_s) >= 0
    assert sum(shares_s) == pytest.approx(budget_s, abs=1e-6)
    totals = [spent + share for spent, share in zip(spent_s, shares_s, strict=True)]
    served = [total for total, share in zip(totals, shares_s, strict=True) if share > 0]
    for level in served:
        assert level == pytest.approx(max(served), abs=1e-6)
    for total in totals:  # nobody who got nothing is behind those who got something
        assert not served or total >= max(served) - 1e-6


def test_no_budget_and_no_end() -> None:
    assert fair_shares_s([5, 0], -3) == (0, 0)
    assert fair_shares_s([5, 0], math.inf) == (math.inf, math.inf)
    assert fair_shares_s([], 10) == ()


def test_what_starting_costs_is_kept_for_each_that_waits() -> None:
    assert next_share_s([0, 0], left_s=100, overhead_s=10) == 40
    assert next_share_s([30, 60], left_s=100, overhead_s=5) == 60  # both end at 90
    assert next_share_s([0, 0, 0], left_s=30, overhead_s=10) == 0  # nothing but starting
    assert next_share_s([7], left_s=math.inf, overhead_s=10) == math.inf


def test_progress_of_a_folder(tmp_path: Path) -> None:
    run = PlannedRun(EFFICIENT, tmp_path / "run")
    assert run.state().step == 0
    assert not run.is_finished(run.state())
    fabric = Fabric(accelerator="cpu", devices=1)
    fit(EFFICIENT, room_data(), run.folder, fabric, Callback(), Limits(steps=3))
    assert (run.state().step, run.is_finished(run.state())) == (3, False)
    fit(EFFICIENT, room_data(), run.folder, fabric, Callback())
    assert (run.state().step, run.is_finished(run.state())) == (6, True)
    other = PlannedRun(replace(EFFICIENT, seed=9), run.folder)
    with pytest.raises(CheckpointError, match="another run: seed is 3 there, 9 here; to continue"):
        other.progress()
