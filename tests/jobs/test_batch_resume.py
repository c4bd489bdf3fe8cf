"""A batch that is run again does what is not right already, and nothing else."""

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batches import NAMES, kept, outputs, pictures, request
from helpers.tiny import synthetic_picture, write_picture
from helpers.videos import flat_frames, write_video

from depthcli.core.camera import Anchor, Intrinsics
from depthcli.core.options import AUTO_TILE, ReadOptions, Upsampling, UpsamplingOptions
from depthcli.errors import Message, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.listing.folder import NameFilter
from depthcli.io.manifest import FAILED, OK, known_rows
from depthcli.jobs.batch.manifests import read_rows
from depthcli.jobs.batch.plan import plan_files, plan_folder
from depthcli.jobs.batch.run import Batch
from depthcli.jobs.batch.tasks import BatchOptions

ALL = dict.fromkeys(NAMES, True)


def test_valid_outputs_are_kept(tmp_path: Path) -> None:
    pictures(tmp_path)
    assert kept(tmp_path) == dict.fromkeys(NAMES, False)
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.png")}
    one_by_three = replace(request(tmp_path), workers=1, batch_size=3)
    assert all(result.is_kept for result in Batch(one_by_three))
    assert written == {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.png")}


@pytest.mark.parametrize(
    "options",
    [
        BatchOptions((Format.NPY,)),
        BatchOptions((Format.PNG16, Format.JSON)),
        BatchOptions(writing=WriterOptions(png_scale=256.0)),
        BatchOptions(writing=WriterOptions(png_normalize=True)),
        BatchOptions(detail=UpsamplingOptions(Upsampling.BILINEAR)),
        BatchOptions(detail=UpsamplingOptions(tile_px=AUTO_TILE)),
        BatchOptions(camera=Intrinsics(focal_px=300.0)),
        BatchOptions(camera=Intrinsics(hfov_deg=80.0)),
        BatchOptions(reading=ReadOptions(white_level=4095)),
        BatchOptions(anchors=(Anchor(3, 4, 2.5),)),
        BatchOptions((Format.PREVIEW,), writing=WriterOptions(legend=True)),
    ],
)
def test_a_changed_option_is_done_again(tmp_path: Path, options: BatchOptions) -> None:
    write_picture(tmp_path / "in" / "a.png")
    assert kept(tmp_path) == {"a.png": False}
    assert kept(tmp_path, options=options) == {"a.png": False}
    assert kept(tmp_path, options=options) == {"a.png": True}
    assert kept(tmp_path, "once", options) == {"a.png": False}
    once = outputs(tmp_path / "once")
    assert {name: d for name, d in outputs(tmp_path / "out").items() if name in once} == once


def test_resume_ignores_options_without_effect_on_output(tmp_path: Path) -> None:
    pictures(tmp_path)
    kept(tmp_path)
    options = BatchOptions(max_pixels=5000)
    assert kept(tmp_path, options=options) == ALL
    found = request(tmp_path)
    auto = replace(found, model=SessionLoader(found.model.model, threads=2))
    assert all(result.is_kept for result in Batch(auto))


def test_a_changed_input_is_done_again(tmp_path: Path) -> None:
    pictures(tmp_path)
    kept(tmp_path)
    old = outputs(tmp_path / "out")
    (tmp_path / "in" / "z.png").replace(tmp_path / "in" / "a.png")
    assert kept(tmp_path) == {"a.png": False, "hall/b.png": True}
    assert outputs(tmp_path / "out")["a.depth.png"] == old["z.depth.png"] != old["a.depth.png"]


@pytest.mark.parametrize("damage", ["missing", "changed", "cut"])
def test_a_damaged_output_is_made_again(tmp_path: Path, damage: str) -> None:
    pictures(tmp_path)
    kept(tmp_path)
    good = outputs(tmp_path / "out")
    path = tmp_path / "out" / "a.depth.png"
    data = path.read_bytes()
    path.unlink()
    if damage != "missing":
        path.write_bytes(data[:-1] + (b"" if damage == "cut" else b"x"))
    assert kept(tmp_path) == {**ALL, "a.png": False}
    assert outputs(tmp_path / "out") == good


def test_a_sensor_s_depth_is_not_replaced(tmp_path: Path) -> None:
    pictures(tmp_path)
    sensor = write_picture(tmp_path / "out" / "a.depth.png")
    before = sensor.read_bytes()
    rows = [result.row for result in Batch(request(tmp_path))]
    (problem,) = [row.error for row in rows if row.error]
    assert isinstance(problem, Message)
    assert str(sensor) in problem.problem
    assert [row.input for row in rows if row.status == OK] == ["z.png", "hall/b.png"]
    assert sensor.read_bytes() == before
    (again, *_) = Batch(request(tmp_path, options=BatchOptions(overwrite=True)))
    assert again.row.status == OK
    assert sensor.read_bytes() != before


def test_failed_inputs_are_tried_again(tmp_path: Path) -> None:
    pictures(tmp_path)
    path = tmp_path / "in" / "z.png"
    good = path.read_bytes()
    path.write_bytes(good[:50])
    for _ in range(2):
        statuses = {result.row.input: result.row.status for result in Batch(request(tmp_path))}
        assert statuses == {**dict.fromkeys(NAMES, OK), "z.png": FAILED}
    path.write_bytes(good)
    assert kept(tmp_path) == {**ALL, "z.png": False}
    row = known_rows(tmp_path / "out").row("z.png")
    assert row.error is None


def test_a_batch_of_some_files_forgets_no_other(tmp_path: Path) -> None:
    pictures(tmp_path)
    (tmp_path / "in" / "d.jpg").touch()
    kept(tmp_path)
    some = plan_files(["z.png"], "mine", str(tmp_path / "in"), str(tmp_path / "out"))
    assert [result.is_kept for result in Batch(replace(request(tmp_path), plan=some))] == [True]
    assert known_rows(tmp_path / "out").row("d.jpg") is not None
    assert kept(tmp_path) == {**ALL, "d.jpg": False}


@pytest.mark.parametrize("is_part", [True, False])
def test_failed_rows_of_files_left_out_stay(tmp_path: Path, is_part: bool) -> None:
    pictures(tmp_path)
    bad = tmp_path / "in" / "bad.png"
    bad.write_bytes(b"no picture")
    list(Batch(request(tmp_path)))
    bad.unlink()
    again = request(tmp_path)
    if is_part:
        wanted = NameFilter.of(["a.png"], [])
        again = replace(
            again, plan=plan_folder(str(tmp_path / "in"), str(tmp_path / "out"), wanted)
        )
    list(Batch(again))
    assert (known_rows(tmp_path / "out").row("bad.png") is not None) is is_part


def test_a_row_whose_output_is_another_input_s_now_is_dropped(tmp_path: Path) -> None:
    pictures(tmp_path)
    list(Batch(request(tmp_path)))
    (tmp_path / "in/a.png").rename(tmp_path / "in/a.jpg")
    (tmp_path / "in/z.png").unlink()
    list(Batch(request(tmp_path)))
    rows = read_rows(tmp_path / "out")
    assert [row.input for row in rows] == ["a.jpg", "hall/b.png", "z.png"]


def test_rows_that_are_not_ours_are_passed_over(tmp_path: Path) -> None:
    write_picture(tmp_path / "in" / "a.png", synthetic_picture(24, 32))
    (tmp_path / "out").mkdir()
    strange = b'{"input": 3}\n[]\nno json\n\xff\xfe\n'
    (tmp_path / "out" / "manifest.jsonl").write_bytes(strange)
    with pytest.raises(UsageError):
        kept(tmp_path)
    (tmp_path / "out" / "manifest.jsonl").unlink()
    assert kept(tmp_path) == {"a.png": False}
    with (tmp_path / "out" / "manifest.jsonl").open("ab") as manifest:
        manifest.write(strange)
    assert kept(tmp_path) == {"a.png": True}


def test_a_video_whose_name_is_no_longer_shared_is_done_again(tmp_path: Path) -> None:
    write_video(tmp_path / "in" / "a.mp4", flat_frames(range(3)))
    sibling = write_picture(tmp_path / "in" / "a.jpg")
    assert kept(tmp_path) == {"a.jpg": False, "a.mp4": False}
    assert (tmp_path / "out" / "a.mp4.depth.mkv").is_file()
    sibling.unlink()
    foreign = tmp_path / "out" / "a.depth.mkv"
    write_video(foreign, flat_frames(range(3)))
    before = foreign.read_bytes()
    (refused,) = Batch(request(tmp_path))
    assert refused.row.error
    assert foreign.read_bytes() == before
    foreign.unlink()
    assert kept(tmp_path) == {"a.mp4": False}
    assert kept(tmp_path) == {"a.mp4": True}


def test_resume_ignores_order_of_formats_and_pixel_limit(tmp_path: Path) -> None:
    write_picture(tmp_path / "in" / "a.png")
    write_video(tmp_path / "in" / "b.mp4", flat_frames(range(3)))
    asked = BatchOptions((Format.PNG16, Format.EXR))
    assert kept(tmp_path, options=asked) == {"a.png": False, "b.mp4": False}
    limited = BatchOptions((Format.EXR, Format.PNG16), max_pixels=10**6)
    assert kept(tmp_path, options=limited) == {"a.png": True, "b.mp4": True}


def test_a_picture_that_is_named_like_a_frame_is_not_done_again(tmp_path: Path) -> None:
    write_picture(tmp_path / "in" / "shot.depth.000123.jpg")
    asked = BatchOptions((Format.PLY, Format.JSON))
    for is_kept in (False, True):
        assert kept(tmp_path, options=asked) == {"shot.depth.000123.jpg": is_kept}
