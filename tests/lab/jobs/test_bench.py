"""Benchmarks of a model, and latencies that are measured in turn."""

import sys
import time
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.tiny import known_depth_onnx, load, write_model

from depthcli.core.types import Frame
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.io.images.read import read_image
from depthcli.lab.jobs import bench

SLEEP_S = 0.004


class Slow(Pipeline):
    """A pipeline that takes longer than it needs, and counts."""

    count = 0

    def predict(self, frame: Frame, *rest: Any, **words: Any) -> Any:
        self.count += 1
        time.sleep(SLEEP_S)
        return super().predict(frame, *rest, **words)


def test_throughput_is_that_of_workers_that_take_turns(model_folder: Path, tmp_path: Path) -> None:
    slow = Slow(load(model_folder, provider="cpu", threads=1).session)
    rate = bench.throughput(slow, bench.synthetic_image(64, 48), tmp_path, workers=2, seconds=0)
    assert slow.count == 9
    # The last of nine images by two workers ends four turns after the first.
    assert 0 < rate <= 8 / (3 * SLEEP_S)


def test_bench_measures_a_network_that_needs_known_depth(tmp_path: Path) -> None:
    spec = {"input": "lidar", "width": 8, "height": 6}
    folder = write_model(tmp_path, known_depth_onnx(), input__known_depth=spec)
    assert bench.run_bench(SessionLoader(folder, "cpu"), (64, 48), 0.01, workers=1).end_to_end.runs


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_peak_memory_is_that_of_the_system() -> None:
    (line,) = (x for x in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in x)
    assert bench.peak_memory_mb() == pytest.approx(int(line.split()[1]) * 1024 / 1e6, rel=0.02)


@pytest.mark.parametrize("size", [(640, 480), (1, 1), (301, 7)])
def test_synthetic_image_resembles_a_photograph(size: tuple[int, int]) -> None:
    data = bench.synthetic_image(*size)
    frame = read_image(None, data)
    assert (frame.width, frame.height) == size
    if size == (640, 480):
        detail = cv2.Laplacian(frame.pixels.astype(np.float32), cv2.CV_32F)
        # The figures of two versions are of the same image.
        figures = (frame.pixels.mean(), frame.pixels.std(), detail.std(), len(data))
        assert figures == pytest.approx((131.4, 50.0, 15.1, 70_700), rel=1e-2)


def test_first_run_of_each_turn_is_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[int] = []
    taken_s = iter([0.004, 0.001, 0.005, 0.003, 0.002])
    monkeypatch.setattr(bench, "_elapsed_s", lambda action: action() or next(taken_s))
    (latency,) = bench.measure_latencies([lambda: called.append(1)], seconds=0)
    assert (latency.runs, len(called)) == (5, 8)
    assert latency.median_ms == pytest.approx(3)
    assert latency.min_ms == pytest.approx(1)
    assert latency.noise == pytest.approx((4.5 - 1.5) / 2 / 3)  # the middle half of the five


def test_models_take_turns_at_their_sizes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shapes: list[tuple[int, ...]] = []
    run = Session.run

    def noted(self: Session, batch: np.ndarray) -> np.ndarray:
        shapes.append(batch.shape)
        assert -1 <= batch.min() < 0 < batch.max() <= 1
        return run(self, batch)

    monkeypatch.setattr(Session, "run", noted)
    sizes = {"a": {}, "b": {"input__colour": "rgb", "input__width": 32}}
    pipelines = [load(write_model(tmp_path / name, **size)) for name, size in sizes.items()]
    runs = [bench.network_run(pipeline) for pipeline in pipelines]
    latencies = bench.measure_latencies(runs, seconds=0)
    assert all(0 < latency.median_ms < 1000 for latency in latencies)
    turns = [shape for shape, _ in groupby(shapes)]
    assert turns == [(1, 1, 12, 16), (1, 3, 12, 32)] * 3
    assert len(shapes) == sum(3 + latency.runs for latency in latencies)
