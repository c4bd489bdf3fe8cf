"""Figures of speed, from work that is known to take some time at least."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline, load
from depthcli.io.images.read import read_image
from depthcli.jobs import bench as speed
from depthcli.models.catalog import find_model

if TYPE_CHECKING:
    from depthcli.core.types import DepthMap, Frame
    from depthcli.inference.session import Session

SLEEP_S = 0.004


class Slow(Pipeline):
    """A pipeline that takes longer than it needs, and counts."""

    count = 0

    def predict(self, frame: Frame, **camera: float | None) -> DepthMap:
        self.count += 1
        time.sleep(SLEEP_S)
        return super().predict(frame, **camera)


def test_each_picture_takes_at_least_its_time(model_folder: Path) -> None:
    plain = load(model_folder, provider="cpu", threads=1)
    slow = Slow(plain.session)
    found = speed.measure_speed(slow, plain, speed.synthetic_picture(64, 48), workers=2, seconds=0)
    assert found.end_to_end.min_ms >= 1e3 * SLEEP_S
    assert found.end_to_end.min_ms <= found.end_to_end.median_ms
    assert found.end_to_end.runs == found.network.runs == 5
    assert slow.count == 3 + 5


def test_workers_take_turns_with_a_few_files(model_folder: Path, tmp_path: Path) -> None:
    slow = Slow(load(model_folder, provider="cpu", threads=1).session)
    picture, folder = speed.synthetic_picture(64, 48), tmp_path / "speed"
    folder.mkdir()
    pictures_per_s = speed._throughput(slow, picture, folder, workers=2, seconds=0)
    assert slow.count == 9
    # The last of nine pictures by two workers ends four turns after the first.
    assert 0 < pictures_per_s <= 8 / (3 * SLEEP_S)
    assert sorted(path.name for path in folder.iterdir()) == [f"{n}.png" for n in range(4)]


def test_measuring_lasts_as_long_as_asked(model_folder: Path) -> None:
    pipeline = load(model_folder, provider="cpu", threads=1)
    start_s = time.perf_counter()
    speed.measure_speed(
        pipeline, pipeline, speed.synthetic_picture(64, 48), workers=1, seconds=0.05
    )
    assert time.perf_counter() - start_s > 3 * 0.05


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_peak_memory_is_what_the_system_says() -> None:
    (line,) = (x for x in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in x)
    assert speed.peak_memory_mb() == pytest.approx(int(line.split()[1]) * 1024 / 1e6, rel=0.02)


@pytest.mark.parametrize("size", [(640, 480), (1, 1), (301, 7)])
def test_the_made_picture_weighs_what_photographs_do(size: tuple[int, int]) -> None:
    data = speed.synthetic_picture(*size)
    frame = read_image(None, data)
    assert (frame.width, frame.height) == size
    assert data == speed.synthetic_picture(*size)
    if size == (640, 480):
        assert 50_000 < len(data) < 150_000
        detail = cv2.Laplacian(frame.pixels.astype(np.float32), cv2.CV_32F)
        # The figures of two versions are of the same picture.
        found = (frame.pixels.mean(), frame.pixels.std(), detail.std(), len(data))
        assert found == pytest.approx((131.4, 50.0, 15.1, 70_700), rel=1e-2)


def test_the_figures_belong_to_a_model_and_a_provider(model_folder: Path) -> None:
    loader = SessionLoader(model_folder, "cpu")
    done = speed.run_bench(speed.BenchRequest(loader, synthetic_px=(64, 48), workers=2, seconds=0))
    assert (done.model, done.provider, done.workers) == ("tiny", "cpu", 2)
    assert done.model_sha256 == find_model(model_folder).sha256
    for latency in (done.speed.network, done.speed.end_to_end):
        assert 0 < latency.min_ms <= latency.median_ms
        assert latency.noise >= 0


def test_what_a_model_settled_for_is_said(
    model_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load_model = SessionLoader.load

    def settled(self: SessionLoader) -> Session:
        session = load_model(self)
        session.warnings = (f"{self.threads} threads",)
        return session

    monkeypatch.setattr(SessionLoader, "load", settled)
    said: list[str] = []
    loader = SessionLoader(model_folder, "cpu", 3)
    asked = speed.BenchRequest(loader, synthetic_px=(64, 48), workers=2, seconds=0)
    speed.run_bench(asked, said.append)
    assert said == ["3 threads"]


def test_throughput_is_that_between_the_first_picture_and_the_last(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, model_folder: Path
) -> None:
    ends_s = [10.0, 12.0, 10.5, 11.0]
    monkeypatch.setattr(speed, "ordered_map", lambda *_args, **_words: iter(ends_s))
    pipeline = load(model_folder, provider="cpu", threads=1)
    assert speed._throughput(pipeline, b"", tmp_path, workers=1, seconds=0) == 1.5
