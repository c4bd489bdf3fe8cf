"""Names of a video's outputs, files they replace, and runs that were stopped."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.batches import request
from helpers.requests import video_request
from helpers.tiny import write_model
from helpers.videos import flat_frames, write_mp4, write_video

from depthcli.core.camera import Intrinsics
from depthcli.errors import OutputError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import WriterOptions
from depthcli.jobs.batch.run import Batch, dry_run
from depthcli.jobs.video.plan import VideoRequest, VideoSettings, video_base, video_destination
from depthcli.jobs.video.run import video
from depthcli.video.depth_video import DepthVideo
from depthcli.video.formats import VideoFormat


@pytest.mark.parametrize(
    ("names", "bases"),
    [
        ("p.1001.exr p.1002.exr", {"p.%04d.exr": "p", "p.####.exr": "p", "p.%d.exr": "p"}),
        ("p.1001.exr p.mov p.jpg", {"p.%04d.exr": "p", "p.mov": "p"}),
        ("p.1001_l.exr p.1001_r.exr", {"p.%04d_l.exr": "p_l", "p.%04d_r.exr": "p_r"}),
        ("1001.exr q.mov", {"%04d.exr": "sequence", "q.mov": "q"}),
        ("p/1001.exr p.mov", {"p": "p", "p.mov": "p"}),
    ],
)
def test_a_sequence_is_named_as_one_file(names: str, bases: dict[str, str], tmp_path: Path) -> None:
    for name in names.split():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert {name: video_base(tmp_path / name) for name in bases} == bases


BOTH = (VideoFormat.MKV, VideoFormat.MP4)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a clip and a video of another program."""
    write_mp4(tmp_path / "in" / "clip.mp4", flat_frames(range(3)))
    write_video(tmp_path / "in" / "clip.depth.mkv", flat_frames(range(9)))
    return tmp_path / "in"


@pytest.mark.parametrize(
    ("output", "formats"),
    [(None, ()), ("clip.depth.mkv", ()), ("clip.mkv", BOTH), ("clip.preview.mp4", BOTH)],
)
def test_it_is_not_replaced(
    output: str | None, formats: tuple[VideoFormat, ...], folder: Path, loader: SessionLoader
) -> None:
    place = folder / "clip.depth.mkv"
    before = place.read_bytes()
    target = None if output is None else f"{folder}/{output}"
    request = video_request(folder / "clip.mp4", target, formats, model=loader)
    with pytest.raises(OutputError, match=str(place)):
        video(request)
    assert {path.name for path in folder.iterdir()} == {"clip.mp4", "clip.depth.mkv"}
    assert place.read_bytes() == before
    assert video(replace(request, overwrite=True)).frames == 3
    whole = place.read_bytes()
    place.write_bytes(whole[: len(whole) // 2])
    assert video(request).frames == 3
    assert place.read_bytes() == whole


@pytest.mark.parametrize("name", ["clip.preview.mp4", "a.webm", "a.mov", "x.stereo.mp4"])
def test_preview_and_stereo_videos_are_replaced_if_depthcli_wrote_them(
    name: str, folder: Path, loader: SessionLoader
) -> None:
    place, settings = folder / name, VideoSettings(camera=Intrinsics(hfov_deg=60))
    request = video_request(folder / "clip.mp4", place, model=loader, settings=settings)
    foreign = (folder / "clip.depth.mkv").read_bytes()
    place.write_bytes(foreign)
    with pytest.raises(OutputError, match=str(place)):
        video(request)
    assert place.read_bytes() == foreign
    assert video(replace(request, overwrite=True)).frames == 3
    data = place.read_bytes()
    assert video(request).frames == 3
    assert place.read_bytes() == data


def test_a_batch_does_not_replace_it_in_any_run(folder: Path) -> None:
    place = folder.parent / "out" / "clip.depth.mkv"
    place.parent.mkdir()
    (folder / "clip.depth.mkv").rename(place)
    before = place.read_bytes()
    job = request(folder.parent)
    for _ in range(2):
        (result,) = Batch(job)
        assert "does not state that depthcli wrote it" in result.row.error
        (would,) = dry_run(job, job.model.load())
        assert (would[0], would[-1]) == ("fail", result.row.error)
    assert place.read_bytes() == before
    place.unlink()
    for is_kept in (False, True):
        (result,) = Batch(job)
        assert (result.row.error, result.is_kept) == (None, is_kept)


MKV, NPY, PNG16 = VideoFormat.MKV, VideoFormat.NPY, VideoFormat.PNG16


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    return write_mp4(tmp_path / "clip.mp4", flat_frames(range(0, 96, 4)))


@pytest.mark.parametrize("sidecar", [False, True])
def test_the_sidecar_of_an_earlier_run_does_not_describe_new_arrays(
    clip: Path, tmp_path: Path, loader: SessionLoader, sidecar: bool
) -> None:
    write_model(tmp_path / "model", camera={"hfov_deg": 60.0})
    out = tmp_path / "out"
    for with_sidecar, hfov_deg in ((True, 40.0), (sidecar, 60.0)):
        settings = VideoSettings(camera=Intrinsics(hfov_deg=hfov_deg))
        there = video_destination(f"{out}/", (NPY,), sidecar=with_sidecar)
        video(VideoRequest(str(clip), there, model=loader, settings=settings))
    written = out / "clip.depth.json"
    assert written.exists() == sidecar
    if sidecar:
        focal_px = 32 / np.tan(np.deg2rad(30))
        assert json.loads(written.read_text())["focal_px"] == pytest.approx(focal_px)


def test_a_foreign_json_by_arrays_stays(clip: Path, tmp_path: Path, loader: SessionLoader) -> None:
    (tmp_path / "out").mkdir()
    place = tmp_path / "out" / "clip.depth.json"
    for text in ('{"focal_px": 9}', "no json"):
        place.write_text(text)
        video(video_request(clip, f"{tmp_path}/out/", (NPY,), model=loader))
        assert place.read_text() == text


@pytest.mark.parametrize(("vmin", "vmax"), [(1.2, 2.0), (1.5, 3.0)])
def test_the_ends_of_a_normalized_video_are_those_that_were_asked_for(
    clip: Path, tmp_path: Path, vmin: float, vmax: float
) -> None:
    relative = {"output__kind": "relative", "output__min_m": None, "output__max_m": None}
    loader = SessionLoader(write_model(tmp_path / "relative", **relative), "cpu", threads=1)
    settings = VideoSettings(writing=WriterOptions(vmin=vmin, vmax=vmax))
    formats = (MKV, NPY)
    video(video_request(clip, f"{tmp_path}/out/", formats, model=loader, settings=settings))
    steps = np.stack(list(DepthVideo(tmp_path / "out" / "clip.depth.mkv").steps()))[:, 9, 9]
    values = np.stack([np.load(p)[9, 9] for p in sorted((tmp_path / "out").glob("*.npy"))])
    assert (np.diff(steps.astype(int)) >= 0).all()
    free = (steps > steps.min()) & (steps < steps.max())
    slope, start = np.polyfit(values[free], steps[free], 1)
    low, high = (1 - start) / slope, (65535 - start) / slope
    assert (low, high) == (pytest.approx(vmin, abs=0.01), pytest.approx(vmax, abs=0.01))
