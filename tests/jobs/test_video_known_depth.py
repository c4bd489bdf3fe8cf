"""Known depth of the frames of a video."""

from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from helpers.requests import video_request
from helpers.tiny import synthetic_image, write_image, write_model
from helpers.videos import flat_frames, write_mp4

from depthcli.core.camera import Anchor, Intrinsics
from depthcli.core.types import DepthKind
from depthcli.errors import InputError, OutputError
from depthcli.inference.loading import SessionLoader
from depthcli.jobs.video.plan import VideoResult, VideoSettings
from depthcli.jobs.video.run import video
from depthcli.known import sources as known_depth
from depthcli.known.files import KnownDepthFiles
from depthcli.video.formats import VideoFormat
from depthcli.video.frames import Point, Span

HEADER = "x,y,depth_m"
#: the first of images, and what a millisecond is in their names: of EuRoC and TUM
EUROC = ("1403636579763555584", "1e6")
TUM = ("1305031102.960304", "0.001")
FRAMES = 6


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """Six frames at 25 a second, 2.6 m for the tiny model."""
    return write_mp4(tmp_path / "clip.mp4", flat_frames([51] * FRAMES), Fraction(25))


def run(clip: Path, loader: SessionLoader, known: object, **settings: object) -> VideoResult:
    anchors = known if isinstance(known, tuple) else KnownDepthFiles(str(known))
    return video(
        video_request(
            clip,
            f"{clip.parent}/out/",
            (VideoFormat.NPY,),
            model=loader,
            settings=VideoSettings(anchors=anchors, **settings),
        )
    )


def depths_m(clip: Path) -> list[float]:
    """Median depth of each frame that was written, in their order."""
    files = sorted((clip.parent / "out").glob("*.npy"))
    return [float(np.median(np.load(file))) for file in files]


def test_points_of_all_frames_fit_each(clip: Path, loader: SessionLoader) -> None:
    done = run(clip, loader, (Anchor(5, 4, 5.2),))
    assert depths_m(clip) == pytest.approx([5.2] * FRAMES, abs=0.05)
    assert done.metadata()["anchors"] == {"used": 1, "given": 1, "residual_m": 0, "fit": "global"}


def test_a_folder_has_a_file_for_each_frame_by_its_number(
    clip: Path, loader: SessionLoader, tmp_path: Path
) -> None:
    """Also of a part of the video whose files are numbered from elsewhere."""
    depths = tmp_path / "known"
    depths.mkdir()
    for number in (2, 3, 5):
        (depths / f"cam1_lidar-{number:04d}.csv").write_text(f"{HEADER}\n5,4,{number}\n")
    np.save(depths / "cam1_lidar-0004.npy", np.full((48, 64), 4, np.float32))
    start = Point(Fraction(2), in_frames=True)
    done = run(clip, loader, depths, span=Span(start), start_number=1001)
    assert depths_m(clip) == pytest.approx([2, 3, 4, 5], abs=0.05)
    assert list(done.numbers) == [1001, 1002, 1003, 1004]


@pytest.mark.parametrize(("first", "millisecond"), [EUROC, TUM])
def test_files_named_by_the_time_stamps_of_images_belong_to_them(
    first: str, millisecond: str, loader: SessionLoader, tmp_path: Path
) -> None:
    """As colour and aligned depth of one camera, or of another's times."""

    def named(suffix: str, late_ms: int) -> list[Path]:
        times = [Decimal(first) + (n * 50 + late_ms) * Decimal(millisecond) for n in range(3)]
        return [tmp_path / suffix / f"{time}.{suffix}" for time in times]

    for file in named("png", 0):
        write_image(file, synthetic_image(48, 64))
    (tmp_path / "csv").mkdir()
    for late_ms, within_s in ((0, None), (19, None), (24, 0.025)):
        for file in (tmp_path / "csv").iterdir():
            file.unlink()
        for number, file in enumerate(named("csv", late_ms)):
            file.write_text(f"{HEADER}\n5,4,{number + 3}\n")
        run(tmp_path / "png", loader, tmp_path / "csv", anchors_within_s=within_s)
        images = [np.load(file) for file in sorted((tmp_path / "out").glob("*.npy"))]
        assert [image[4, 5] for image in images] == pytest.approx([3, 4, 5], abs=0.01)
    with pytest.raises(InputError):  # half a frame is 20 ms
        run(tmp_path / "png", loader, tmp_path / "csv")


@pytest.mark.parametrize("column", ["frame", "time_s"])
def test_table_of_frames_points(
    column: str, clip: Path, loader: SessionLoader, tmp_path: Path
) -> None:
    """Frames without points keep the model's depth, and are counted."""
    keys = {"frame": ("1", "4"), "time_s": ("0.045", "0.15")}[column]
    table = tmp_path / "known.csv"
    table.write_text(
        f"{column},{HEADER}\n" + "".join(f"{key},5,4,4\n{key},6,4,4\n" for key in keys)
    )
    done = run(clip, loader, table)
    assert depths_m(clip) == pytest.approx([2.6, 4, 2.6, 2.6, 4, 2.6], abs=0.05)
    assert "4 of 6 frames" in done.warnings[-1]
    assert "anchors_within" in done.warnings[-1]


@pytest.mark.parametrize("column", ["frame", "time_s"])
def test_the_nearest_points_count_for_frames_between_scans_of_a_slower_lidar(
    column: str, clip: Path, loader: SessionLoader, tmp_path: Path
) -> None:
    """10 scans a second, every third frame of a camera of 30."""
    keys = {"frame": (0, 3), "time_s": (0.0, 0.12)}[column]
    table = tmp_path / "known.csv"
    table.write_text(f"{column},{HEADER}\n{keys[0]},5,4,4\n{keys[1]},5,4,5\n")
    done = run(clip, loader, table, anchors_within_s=0.05)
    assert depths_m(clip) == pytest.approx([4, 4, 5, 5, 5, 2.6], abs=0.05)
    assert "1 of 6 frames" in done.warnings[-1]


def test_a_frame_that_points_do_not_fit_is_counted_and_all_fail(
    clip: Path, loader: SessionLoader, tmp_path: Path
) -> None:
    table = tmp_path / "known.csv"
    table.write_text(f"frame,{HEADER}\n0,5,4,4\n1,900,4,4\n")
    done = run(clip, loader, table)
    assert depths_m(clip)[:2] == pytest.approx([4, 2.6], abs=0.05)
    assert "5 of 6 frames" in done.warnings[-1]
    assert "frame 1: " in done.warnings[-1]
    assert "anchors_within" not in done.warnings[-1]
    table.write_text(f"frame,{HEADER}\n77,5,4,4\n")
    with pytest.raises(InputError, match="frame 0 has no known depth"):
        run(clip, loader, table)


def test_relative_depth_becomes_metric_in_every_frame(clip: Path, tmp_path: Path) -> None:
    model = write_model(tmp_path / "relative", output__kind="relative")
    loader = SessionLoader(model, "cpu", threads=1)
    done = run(clip, loader, (Anchor(5, 4, 5.2),), smooth_s=0.2)
    assert done.depth.kind is DepthKind.METRIC
    assert depths_m(clip) == pytest.approx([5.2] * FRAMES, abs=0.05)
    table = tmp_path / "known.csv"
    table.write_text(f"frame,{HEADER}\n0,5,4,4\n")
    with pytest.raises(InputError, match="frame 1 has no known depth"):
        run(clip, loader, table)


def test_known_depth_is_not_replaced_and_belongs_to_one_frame(
    clip: Path, loader: SessionLoader, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    np.save(folder / "clip.depth.000003.npy", np.full((48, 64), 4, np.float32))
    with pytest.raises(OutputError):
        run(clip, loader, folder)
    (folder / "other-3.csv").write_text(f"{HEADER}\n5,4,4\n")
    with pytest.raises(InputError, match="both of frame 3"):
        run(clip, loader, folder)


def test_frames_of_other_extrinsics_are_not_kept(tmp_path: Path) -> None:
    """A run that was stopped to correct them, and resumed."""
    np.array([[3, 0, 0, 1]], "<f4").tofile(tmp_path / "scan.bin")
    pose, camera = tmp_path / "lidar_to_camera.txt", Intrinsics(50, centre_px=(31.5, 23.5))
    known, states = KnownDepthFiles(str(tmp_path / "scan.bin"), camera=camera, extrinsics=pose), []
    for shift in ("0.1", "0.15"):
        pose.write_text(f"0 -1 0 {shift}\n0 0 -1 0\n1 0 0 0\n")
        states.append(known_depth.KnownDepthOfFrames(known).states())
    assert states[0] != states[1]
