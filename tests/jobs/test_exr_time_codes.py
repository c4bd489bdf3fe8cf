"""Depth EXRs keep the frame rate and the time code of their plate."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenEXR
from helpers.plates import CROP, DISPLAY, time_code_of, write_plate
from helpers.requests import predict_request, video_request

from depthcli.inference.loading import SessionLoader
from depthcli.io.exr.file import ExrPart, read_exr_header, time_code_attribute
from depthcli.io.formats.table import Format
from depthcli.io.images.read import read_image
from depthcli.jobs.batch.plan import plan_files
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.jobs.convert import ConvertRequest, convert
from depthcli.jobs.predict import predict
from depthcli.jobs.video.plan import VideoSettings
from depthcli.jobs.video.run import video
from depthcli.video.formats import VideoFormat
from depthcli.video.frames import Point, Span

FILM = Fraction(24)


def stated(path: Path) -> tuple[Fraction | None, tuple[int, ...] | None]:
    part = ExrPart.of(read_exr_header(path))
    return part.rate, part.time_code


def test_depth_of_a_plate(tmp_path: Path, loader: SessionLoader) -> None:
    plate = write_plate(tmp_path / "in", 7, CROP)
    list(predict(predict_request([plate], f"{tmp_path}/a.exr", (Format.EXR,), model=loader)))
    convert(ConvertRequest(f"{tmp_path}/a.exr", f"{tmp_path}/b.exr"))
    plan = plan_files([plate.name], "mine", str(plate.parent), str(tmp_path / "c"))
    list(Batch(BatchRequest(plan, BatchOptions((Format.EXR,)), loader)))
    for name in ("a.exr", "b.exr", "c/plate.7.depth.exr"):
        assert stated(tmp_path / name) == (FILM, time_code_of(7))


def test_depth_of_a_sequence(tmp_path: Path, loader: SessionLoader) -> None:
    for number in range(1, 5):
        write_plate(tmp_path / "in", number, DISPLAY)
    settings = VideoSettings(span=Span(every=Point(Fraction(2), in_frames=True)))
    pattern, out = f"{tmp_path}/in/plate.%d.exr", f"{tmp_path}/out.%d.exr"
    video(video_request(pattern, out, (VideoFormat.EXR,), model=loader, settings=settings))
    assert stated(tmp_path / "out.1.exr") == (FILM / 2, time_code_of(1))
    assert stated(tmp_path / "out.3.exr") == (FILM / 2, time_code_of(3))


def write_parts(path: Path, number: int) -> Path:
    """Three parts, of which the first alone states rate and time code, and the last is depth."""
    path.parent.mkdir(exist_ok=True)
    shown = {"type": OpenEXR.scanlineimage}
    gray = np.full((16, 16), 0.5, np.float32)
    code = time_code_attribute(time_code_of(number))
    parts = [
        OpenEXR.Part({**shown, "framesPerSecond": FILM, "timeCode": code}, {"A": gray}, "matte"),
        OpenEXR.Part(dict(shown), dict.fromkeys("RGB", gray), "rgba"),
        OpenEXR.Part(dict(shown), {"Z": gray}, "depth"),
    ]
    OpenEXR.File(parts).write(str(path))
    return path


def test_of_several_parts_the_first_may_state_them(tmp_path: Path, loader: SessionLoader) -> None:
    plate = write_parts(tmp_path / "in" / "p.7.exr", 7)
    list(predict(predict_request([plate], f"{tmp_path}/a.exr", (Format.EXR,), model=loader)))
    convert(ConvertRequest(str(plate), f"{tmp_path}/b.exr"))
    pattern, out = f"{tmp_path}/in/p.%d.exr", f"{tmp_path}/out.%d.exr"
    video(video_request(pattern, out, (VideoFormat.EXR,), model=loader))
    for name in ("a.exr", "b.exr", "out.7.exr"):
        assert stated(tmp_path / name) == (FILM, time_code_of(7))


def test_a_time_code_that_is_none_is_left_out(tmp_path: Path) -> None:
    plate = write_plate(tmp_path, 1, DISPLAY)
    name = b"timeCode\0timecode\0\x08\0\0\0"
    data = plate.read_bytes()
    start = data.index(name) + len(name)
    plate.write_bytes(data[:start] + b"\xff" * 4 + data[start + 4 :])  # hour 45
    assert read_image(plate).time_code is None
    plate.write_bytes(data.replace(b"timeCode\0", b"timecode\0"))
    assert read_image(plate).time_code is None
    plate.write_bytes(data)
    assert read_image(plate).time_code == time_code_of(1)
