"""What an earlier run of other options leaves beside the outputs of a video."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.requests import video_request
from helpers.tiny import write_model
from helpers.videos import flat_frames, write_mp4
from helpers.watched import Watched

from depthcli.core.camera import Intrinsics
from depthcli.core.parallel import Background
from depthcli.inference.loading import SessionLoader
from depthcli.inference.session import Session
from depthcli.io.formats.table import WriterOptions
from depthcli.jobs.video.plan import VideoRequest, VideoSettings, video_destination
from depthcli.jobs.video.run import video
from depthcli.video.depth_video import DepthVideo
from depthcli.video.formats import VideoFormat

MKV, NPY, PNG16 = VideoFormat.MKV, VideoFormat.NPY, VideoFormat.PNG16


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    return write_mp4(tmp_path / "clip.mp4", flat_frames(range(0, 96, 4)))


class Configured(SessionLoader):
    """Sessions of the CPU, which has no options, that state some."""

    def start(self) -> Background[Session]:
        """Load one, and state the options."""
        session = SessionLoader(self.model, self.provider, self.threads).load()
        session.provider_options = dict(self.provider_options)
        return Background(lambda: session)


@pytest.mark.parametrize("precision", ["FP32", "FP16"])
def test_a_run_with_other_provider_options_is_not_resumed(
    precision: str, clip: Path, tmp_path: Path, loader: SessionLoader
) -> None:
    frame, written_ns = tmp_path / "out" / "clip.depth.000003.png", []
    for options in ({"precision": "FP32"}, {"precision": precision}):
        model = Configured(loader.model, "cpu", threads=1, provider_options=options)
        with pytest.raises(KeyboardInterrupt):
            video(
                video_request(clip, f"{tmp_path}/out/", (PNG16,), model=model),
                Watched(9),
            )
        written_ns.append(frame.stat().st_mtime_ns)
    assert (written_ns[0] == written_ns[1]) == (precision == "FP32")


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
