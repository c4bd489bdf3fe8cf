"""Seconds that are told are those of the work, by a clock that only work moves on."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from helpers.batches import request
from helpers.tiny import synthetic_picture, write_model, write_picture
from helpers.videos import flat_frames, write_mp4

from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.io.formats.table import Format
from depthcli.io.manifest.row import OK, Origin, Row
from depthcli.jobs import predict_images as predict_pictures
from depthcli.jobs.batch import options as tally
from depthcli.jobs.batch import tasks as task
from depthcli.jobs.batch import workers as batch_pictures
from depthcli.jobs.batch import workers as batch_videos
from depthcli.jobs.batch.run import Batch
from depthcli.jobs.batch.tasks import Result
from depthcli.jobs.predict import PictureResult, PredictRequest, predict
from depthcli.jobs.video import stages as video_write
from depthcli.jobs.video.plan import VideoRequest
from depthcli.jobs.video.run import video

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

READ_S, PREDICT_S, WRITE_S = 1.0, 6.0, 2.0


class Clock:
    """The time, in the place of ``time``."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def perf_counter(self) -> float:
        return self.now_s

    monotonic = perf_counter

    def during(self, seconds: float, work: Callable[..., Any]) -> Callable[..., Any]:
        """The same work, which takes so long."""

        def longer(*args: Any, **options: Any) -> Any:
            self.now_s += seconds
            return work(*args, **options)

        return longer


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """One by which reading, the network and writing take their time."""
    clock = Clock()
    for module in (batch_pictures, batch_videos, predict_pictures, tally, task, video_write):
        monkeypatch.setattr(module, "time", clock)
    for place, name, seconds in (
        (batch_pictures, "read_image", READ_S),
        (batch_pictures, "write_output", WRITE_S),
        (batch_videos, "video_checksum", READ_S),
        (predict_pictures, "read_image", READ_S),
        (predict_pictures, "write_output", WRITE_S),
        (Pipeline, "predict_many", PREDICT_S),
    ):
        monkeypatch.setattr(place, name, clock.during(seconds, getattr(place, name)))
    return clock


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize(("batch_size", "share_s"), [(1, PREDICT_S), (4, PREDICT_S / 3)])
def test_a_picture_of_a_batch_takes_its_own_time_and_its_share_of_the_network(
    tmp_path: Path, batch_size: int, share_s: float
) -> None:
    for number, name in enumerate("acd"):
        write_picture(tmp_path / "in" / f"{name}.png", synthetic_picture(24, 32 + number))
    (tmp_path / "in" / "b.png").write_bytes(b"no picture")
    (tmp_path / "out" / "d.depth.png" / "in the way").mkdir(parents=True)
    asked = replace(request(tmp_path), workers=1, batch_size=batch_size)
    seconds = {result.row.input: result.row.seconds for result in Batch(asked)}
    whole_s = READ_S + share_s + WRITE_S
    assert seconds == {"a.png": whole_s, "b.png": READ_S, "c.png": whole_s, "d.png": whole_s}


@pytest.mark.usefixtures("clock")
def test_a_video_takes_the_time_of_its_frames(tmp_path: Path) -> None:
    clip = write_mp4(tmp_path / "in" / "clip.mp4", flat_frames([9, 99, 200]))
    (tmp_path / "in" / "bad.mp4").write_bytes(b"no video")
    bad, good = Batch(replace(request(tmp_path), workers=1))
    assert (bad.row.seconds, good.row.seconds) == (READ_S, 3 * PREDICT_S)
    loader = SessionLoader(tmp_path / "model", "cpu")
    done = video(VideoRequest(str(clip), f"{tmp_path}/alone/", model=loader, workers=1))
    assert done.seconds == 3 * PREDICT_S


@pytest.mark.usefixtures("clock")
def test_a_picture_alone_takes_what_all_its_outputs_took(tmp_path: Path) -> None:
    loader = SessionLoader(write_model(tmp_path / "model"), "cpu")
    name = str(write_picture(tmp_path / "a.png"))
    asked = PredictRequest((name, name), f"{tmp_path}/o/", (Format.NPY, Format.JSON), model=loader)
    (done,) = predict(replace(asked, pictures=(name,)))
    assert isinstance(done, PictureResult)
    assert done.seconds == READ_S + PREDICT_S + 2 * WRITE_S


def test_what_is_kept_takes_no_time_of_the_rate(clock: Clock) -> None:
    found = tally.Tally(9)
    assert (found.elapsed_s, found.rate) == (0, 0)
    result = Result(Row("a", OK, Origin("0" * 64, "tiny", "1" * 64, "1.0")))
    for one in (result, result, result, replace(result, is_kept=True)):
        found.add(one)
    clock.now_s += 6
    assert (found.elapsed_s, found.rate, found.completed) == (6, 0.5, 4)
