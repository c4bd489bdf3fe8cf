"""Latencies of models."""

from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny import load, write_model

from depthcli.inference.session import Session
from depthcli.lab.jobs import latency


def test_first_run_of_each_turn_is_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[int] = []
    taken_s = iter([0.004, 0.001, 0.005, 0.003, 0.002])
    monkeypatch.setattr(latency, "_elapsed_s", lambda action: action() or next(taken_s))
    (found,) = latency.measure_latencies([lambda: called.append(1)], seconds=0)
    assert (found.runs, len(called)) == (5, 8)
    assert found.median_ms == pytest.approx(3)
    assert found.min_ms == pytest.approx(1)
    assert found.noise == pytest.approx((4.5 - 1.5) / 2 / 3)  # the middle half of the five


def test_models_take_turns_at_their_sizes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[int, ...]] = []
    run = Session.run

    def noted(self: Session, batch: np.ndarray) -> np.ndarray:
        seen.append(batch.shape)
        assert -1 <= batch.min() < 0 < batch.max() <= 1
        return run(self, batch)

    monkeypatch.setattr(Session, "run", noted)
    sizes = {"a": {}, "b": {"input__colour": "rgb", "input__width": 32}}
    pipelines = [load(write_model(tmp_path / name, **size)) for name, size in sizes.items()]
    runs = [latency.network_run(pipeline) for pipeline in pipelines]
    found = latency.measure_latencies(runs, seconds=0)
    assert all(0 < one.median_ms < 1000 for one in found)
    turns = [shape for shape, _ in groupby(seen)]
    assert turns == [(1, 1, 12, 16), (1, 3, 12, 32)] * 3
    assert len(seen) == sum(3 + one.runs for one in found)
