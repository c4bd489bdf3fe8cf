"""What is said of how long something took."""

from __future__ import annotations

import pytest

from depthcli.inference import latency


def test_runs_after_the_first_three_are_summed_up(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[int] = []
    taken_s = iter([0.004, 0.001, 0.005, 0.003, 0.002])
    monkeypatch.setattr(latency, "_elapsed_s", lambda action: action() or next(taken_s))
    found = latency.measure_latency(lambda: called.append(1), seconds=0)
    assert (found.runs, len(called)) == (5, 8)
    assert found.median_ms == pytest.approx(3)
    assert found.min_ms == pytest.approx(1)
    assert found.noise == pytest.approx((4.5 - 1.5) / 2 / 3)  # the middle half of the five
