"""Trial runs and latencies of models."""

from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny import fixed_inside, load, write_model

from depthcli.errors import InputError, ModelError
from depthcli.inference import measure as latency
from depthcli.inference.measure import check_network
from depthcli.inference.session import Session
from depthcli.models.catalog import find_model

ERROR = ModelError("no depth of a.png")


def session(folder: Path, height: int) -> Session:
    """Of a network that runs on inputs of one height only; its card states 12."""
    return Session(find_model(write_model(folder / "model", fixed_inside(height))), provider="cpu")


def test_a_network_that_works_may_fail_on_an_input(tmp_path: Path) -> None:
    check_network(ERROR, session(tmp_path, 12))


def test_the_first_error_is_that_of_a_network_that_never_works(tmp_path: Path) -> None:
    with pytest.raises(ModelError) as caught:
        check_network(ERROR, session(tmp_path, 13))
    assert caught.value is ERROR


def test_errors_of_the_input_need_no_trial(tmp_path: Path) -> None:
    check_network(InputError("a.png is empty"), session(tmp_path, 13))


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
