"""Options of a batch mean what they mean to one picture and to one video."""

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batches import NAMES, outputs, pictures, request
from helpers.requests import predict_request, video_request
from helpers.videos import flat_frames, with_sound, write_mp4
from helpers.watched import Watched

from depthcli.core.camera import Intrinsics
from depthcli.core.options import GPU_BATCH, Upsampling, UpsamplingOptions
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.jobs.batch.run import Batch, dry_run
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.jobs.predict import predict
from depthcli.jobs.video.plan import VideoSettings
from depthcli.jobs.video.run import video
from depthcli.video.formats import VideoFormat

WRITING = WriterOptions(png_scale=256.0, half=True, colormap="turbo", legend=True)
DETAIL = UpsamplingOptions(Upsampling.BILINEAR)


@pytest.mark.parametrize("camera", [Intrinsics(hfov_deg=80.0), Intrinsics(focal_px=40.0)])
def test_a_file_in_a_batch_becomes_what_it_is_alone(tmp_path: Path, camera: Intrinsics) -> None:
    pictures(tmp_path)
    clip = with_sound(tmp_path / "in" / "clip.mkv", seconds=0.12)
    formats = (Format.PNG16, Format.EXR, Format.PREVIEW, Format.JSON)
    asked = request(
        tmp_path, options=BatchOptions(formats, writing=WRITING, camera=camera, detail=DETAIL)
    )
    results = {result.row.input: result.row for result in Batch(asked)}
    alone, loader = f"{tmp_path}/alone/", asked.model
    picture = str(tmp_path / "in" / "a.png")
    words = {"model": loader, "camera": camera, "writing": WRITING, "detail": DETAIL}
    list(predict(predict_request([picture], alone, formats, **words)))
    settings = VideoSettings(writing=WRITING, camera=camera, detail=DETAIL)
    of_video = (VideoFormat.MKV, VideoFormat.EXR, VideoFormat.MP4, VideoFormat.JSON)
    done = video(video_request(clip, alone, of_video, model=loader, settings=settings))
    wanted, found = outputs(tmp_path / "alone"), outputs(tmp_path / "out")
    assert len(wanted) == 4 + 3 + 3
    assert {name: found.get(name) for name in wanted} == wanted
    assert results["clip.mkv"].warnings == done.warnings
    assert "(given)" in str(results["clip.mkv"].camera)


def test_pixel_limit_holds_in_dry_run_and_batch(tmp_path: Path) -> None:
    pictures(tmp_path)
    write_mp4(tmp_path / "in" / "clip.mp4", flat_frames([9, 99]))
    asked = request(tmp_path, options=BatchOptions(max_pixels=24 * 32))
    would = {one.input: one.error for one in dry_run(asked, asked.model.load())}
    became = {result.row.input: result.row.error for result in Batch(asked)}
    assert [name for name in NAMES if would[name] is None] == ["a.png"]
    assert {name: would[name] for name in NAMES} == {name: became[name] for name in NAMES}
    assert "max_pixels" in str(became["clip.mp4"])


def test_session_warning_is_printed_once_a_batch(tmp_path: Path) -> None:
    pictures(tmp_path)
    (tmp_path / "in" / "a.cr2").touch()
    asked = request(tmp_path)
    session = asked.model.load()
    session.warnings = ("runs on cpu",)
    batch = Batch(asked, session)
    assert batch.warnings == (*asked.plan.warnings, "runs on cpu")
    assert len(batch.warnings) == 2
    assert not any(result.row.warnings for result in batch)


@pytest.mark.parametrize(("provider", "at_once"), [("cpu", 1), ("cuda", GPU_BATCH)])
def test_a_gpu_takes_several_pictures_at_once(tmp_path: Path, provider: str, at_once: int) -> None:
    for number in range(GPU_BATCH + 1):
        (tmp_path / "in").mkdir(exist_ok=True)
        (tmp_path / "in" / f"{number}.png").write_bytes(b"no picture")
    asked = replace(request(tmp_path), workers=1)
    session = asked.model.load()
    session.provider = provider
    sizes: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        from depthcli.jobs.batch.workers import ImageWorker  # noqa: PLC0415

        work = ImageWorker.work
        patch.setattr(
            ImageWorker, "work", lambda self, tasks: sizes.append(len(tasks)) or work(self, tasks)
        )
        list(Batch(asked, session))
    assert (sizes[0], sum(sizes)) == (at_once, GPU_BATCH + 1)


def test_the_frames_of_a_batch_s_videos_are_told(tmp_path: Path) -> None:
    write_mp4(tmp_path / "in" / "clip.mp4", flat_frames([9, 99, 200]))
    watched = Watched()
    list(Batch(request(tmp_path), progress=watched))
    assert watched.begun == [("clip.mp4", 3, "frames")]
    assert watched.counts == [[1, 1, 1]]
