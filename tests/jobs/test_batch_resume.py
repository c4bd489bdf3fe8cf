"""Resuming a batch: what is kept, also from another folder, and its manifest."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batches import NAMES, ORIGIN, images, kept, outputs, request, row
from helpers.tiny import prompted_onnx, synthetic_image, write_image, write_model
from helpers.videos import flat_frames, write_video

from depthcli import __version__
from depthcli.core.camera import Anchor, Intrinsics
from depthcli.core.options import AUTO_TILE, DepthFit, ReadOptions, UpsamplingOptions
from depthcli.errors import Message, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.listing import NameFilter
from depthcli.io.manifest import (
    FAILED,
    OK,
    Journal,
    ManifestRow,
    Shard,
    Summary,
    known_rows,
    merge_manifests,
    read_rows,
    summarize,
)
from depthcli.jobs.batch.plan import plan_files, plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest, dry_run
from depthcli.jobs.batch.tasks import BatchOptions

ALL = dict.fromkeys(NAMES, True)


@pytest.mark.parametrize(
    "options",
    [
        BatchOptions((Format.NPY,)),
        BatchOptions((Format.PNG16, Format.JSON)),
        BatchOptions(writing=WriterOptions(png_scale=256.0)),
        BatchOptions(detail=UpsamplingOptions(tile_px=AUTO_TILE)),
        BatchOptions(camera=Intrinsics(focal_px=300.0)),
        BatchOptions(reading=ReadOptions(white_level=4095)),
        BatchOptions(anchors=(Anchor(3, 4, 2.5),)),
        BatchOptions((Format.PREVIEW,), writing=WriterOptions(legend=True)),
    ],
)
def test_a_changed_option_is_done_again(tmp_path: Path, options: BatchOptions) -> None:
    write_image(tmp_path / "in" / "a.png")
    assert kept(tmp_path) == {"a.png": False}
    assert kept(tmp_path, options=options) == {"a.png": False}
    assert kept(tmp_path, options=options) == {"a.png": True}
    assert kept(tmp_path, "once", options) == {"a.png": False}
    once = outputs(tmp_path / "once")
    assert {name: d for name, d in outputs(tmp_path / "out").items() if name in once} == once


def test_a_changed_input_is_done_again(tmp_path: Path) -> None:
    images(tmp_path)
    kept(tmp_path)
    old = outputs(tmp_path / "out")
    (tmp_path / "in" / "z.png").replace(tmp_path / "in" / "a.png")
    assert kept(tmp_path) == {"a.png": False, "hall/b.png": True}
    assert outputs(tmp_path / "out")["a.depth.png"] == old["z.depth.png"] != old["a.depth.png"]


@pytest.mark.parametrize(("now", "then"), [(__version__, "0.1"), ('"ok"', '"failed"')])
def test_what_another_version_made_or_failed_is_made_again(
    now: str, then: str, tmp_path: Path
) -> None:
    images(tmp_path)
    kept(tmp_path)
    manifest = tmp_path / "out" / "manifest.jsonl"
    manifest.write_text(manifest.read_text().replace(now, then))
    assert kept(tmp_path) == dict.fromkeys(NAMES, False)


def test_another_network_for_known_depth_does_again_what_it_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_image(tmp_path / "in" / "a.png")
    models = tmp_path / "models"
    write_model(models / "default", camera={"hfov_deg": 60.0})
    monkeypatch.setenv("DEPTHCLI_MODELS", str(models))
    five = tuple(Anchor(8 * n + 5, 7 * n + 4, 2 + n) for n in range(5))

    def is_kept(fit: DepthFit | None = None) -> bool:
        job = request(
            tmp_path, "local" if fit else "out", BatchOptions(anchors=five, anchors_fit=fit)
        )
        (result,) = Batch(replace(job, model=SessionLoader(None, "cpu")))
        assert result.row.error is None
        return result.is_kept

    for shift, expected in ((2.0, (False, False)), (2.5, (False, True))):
        output = {"output__transform": "exp", "output__scale": 2.0, "output__shift": shift}
        write_model(models / "prompted", prompted_onnx(), input__prompt=True, **output)
        assert (is_kept(), is_kept(DepthFit.LOCAL)) == expected
        assert is_kept()


@pytest.mark.parametrize("damage", ["missing", "changed", "cut"])
def test_a_damaged_output_is_made_again(tmp_path: Path, damage: str) -> None:
    images(tmp_path)
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
    images(tmp_path)
    sensor = write_image(tmp_path / "out" / "a.depth.png")
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
    images(tmp_path)
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
    images(tmp_path)
    (tmp_path / "in" / "d.jpg").touch()
    kept(tmp_path)
    some = plan_files(["z.png"], "mine", str(tmp_path / "in"), str(tmp_path / "out"))
    assert [result.is_kept for result in Batch(replace(request(tmp_path), plan=some))] == [True]
    assert known_rows(tmp_path / "out").row("d.jpg") is not None
    assert kept(tmp_path) == {**ALL, "d.jpg": False}


@pytest.mark.parametrize("is_part", [True, False])
def test_failed_rows_of_files_left_out_stay(tmp_path: Path, is_part: bool) -> None:
    images(tmp_path)
    bad = tmp_path / "in" / "bad.png"
    bad.write_bytes(b"no image")
    list(Batch(request(tmp_path)))
    bad.unlink()
    again = request(tmp_path)
    if is_part:
        names = NameFilter.of(["a.png"], [])
        again = replace(again, plan=plan_folder(str(tmp_path / "in"), str(tmp_path / "out"), names))
    list(Batch(again))
    assert (known_rows(tmp_path / "out").row("bad.png") is not None) is is_part


def test_a_row_whose_output_is_another_input_s_now_is_dropped(tmp_path: Path) -> None:
    images(tmp_path)
    list(Batch(request(tmp_path)))
    (tmp_path / "in/a.png").rename(tmp_path / "in/a.jpg")
    (tmp_path / "in/z.png").unlink()
    list(Batch(request(tmp_path)))
    rows = read_rows(tmp_path / "out")
    assert [row.input for row in rows] == ["a.jpg", "hall/b.png", "z.png"]


def test_rows_that_are_not_ours_are_passed_over(tmp_path: Path) -> None:
    write_image(tmp_path / "in" / "a.png", synthetic_image(24, 32))
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
    sibling = write_image(tmp_path / "in" / "a.jpg")
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


def test_resume_ignores_options_without_effect_on_output(tmp_path: Path) -> None:
    write_image(tmp_path / "in" / "a.png")
    write_video(tmp_path / "in" / "b.mp4", flat_frames(range(3)))
    options = BatchOptions((Format.PNG16, Format.EXR))
    assert kept(tmp_path, options=options) == {"a.png": False, "b.mp4": False}
    limited = BatchOptions((Format.EXR, Format.PNG16), max_pixels=10**6)
    assert kept(tmp_path, options=limited) == {"a.png": True, "b.mp4": True}
    job = request(tmp_path, options=options)
    auto = replace(job, model=SessionLoader(job.model.model, threads=2))
    assert all(result.is_kept for result in Batch(auto))


def test_an_image_that_is_named_like_a_frame_is_not_done_again(tmp_path: Path) -> None:
    write_image(tmp_path / "in" / "shot.depth.000123.jpg")
    options = BatchOptions((Format.PLY, Format.JSON))
    for is_kept in (False, True):
        assert kept(tmp_path, options=options) == {"shot.depth.000123.jpg": is_kept}


def request_of(folder: Path, inputs: str) -> BatchRequest:
    plan = plan_folder(str(folder / inputs), str(folder / "out"))
    return replace(request(folder), plan=plan)


def made_from_in(folder: Path) -> dict[str, bytes]:
    """The outputs for the folder ``in``."""
    write_image(folder / "in" / "a.png", synthetic_image(24, 32))
    list(Batch(request(folder)))
    return outputs(folder / "out")


@pytest.mark.parametrize("formats", [("png16",), ("png16", "preview"), ("npy",)])
def test_input_of_another_folder_stops_the_batch(tmp_path: Path, formats: tuple[str, ...]) -> None:
    before = made_from_in(tmp_path)
    other = write_image(tmp_path / "other" / "a.png", synthetic_image(24, 40))
    options = BatchOptions(tuple(map(Format, formats)))
    job = replace(request_of(tmp_path, "other"), options=options)
    with pytest.raises(UsageError):
        list(dry_run(job, job.model.load()))
    for _ in range(2):  # nor does the second attempt
        with pytest.raises(UsageError) as refused:
            list(Batch(job))
        assert str(tmp_path / "in" / "a.png") in str(refused.value)
        assert str(other) in str(refused.value)
    assert outputs(tmp_path / "out") == before
    assert all(result.is_kept for result in Batch(request(tmp_path)))


def test_the_manifest_has_the_full_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_image(tmp_path / "in" / "a.png")
    (tmp_path / "in" / "b.png").touch()
    plan = plan_folder("in", "out")
    list(Batch(replace(request(tmp_path), plan=plan)))
    paths = {row.input_path for row in known_rows(tmp_path / "out")}
    assert paths == {str(tmp_path / "in" / name) for name in ("a.png", "b.png")}


def test_a_copy_of_the_folder_resumes(tmp_path: Path) -> None:
    made_from_in(tmp_path)
    shutil.copytree(tmp_path / "in", tmp_path / "copy")
    assert all(result.is_kept for result in Batch(request_of(tmp_path, "copy")))


def test_a_folder_that_is_gone_is_no_reason(tmp_path: Path) -> None:
    before = made_from_in(tmp_path)
    write_image(tmp_path / "other" / "a.png", synthetic_image(24, 40))
    job = request_of(tmp_path, "other")
    shutil.rmtree(tmp_path / "in")
    (result,) = Batch(job)
    assert result.row.error is None
    assert outputs(tmp_path / "out") != before


def test_neither_is_a_link_to_the_folder(tmp_path: Path) -> None:
    made_from_in(tmp_path)
    (tmp_path / "link").symlink_to("in")
    write_image(tmp_path / "in" / "a.png", synthetic_image(24, 40))
    (result,) = Batch(request_of(tmp_path, "link"))
    assert (result.is_kept, result.row.error) == (False, None)


def test_videos_are_not_replaced_either(tmp_path: Path) -> None:
    for folder, level in (("in", 40), ("other", 200)):
        write_video(tmp_path / folder / "clip.mkv", flat_frames([level] * 2))
    list(Batch(request(tmp_path)))
    before = outputs(tmp_path / "out")
    with pytest.raises(UsageError):
        list(Batch(request_of(tmp_path, "other")))
    assert outputs(tmp_path / "out") == before


def bad(name: str) -> ManifestRow:
    return ManifestRow(name, FAILED, ORIGIN, error="is empty")


def filled(folder: Path, *rows: ManifestRow, shard: Shard | None = None) -> None:
    journal = Journal(folder, shard or Shard())
    for entry in rows:
        journal.add(entry)
    journal.finish([entry.input for entry in rows])


def test_parts_of_shards_are_summed_up_and_merged(tmp_path: Path) -> None:
    rows = [row(str(number)) for number in range(20)] + [bad("x"), bad("y")]
    for number in (1, 2, 3):
        shard = Shard(number, 3)
        held = [entry for entry in rows if shard.holds(entry.input)]
        assert held
        filled(tmp_path, *held, shard=shard)
    (tmp_path / ".depthcli-batch-2-of-4.jsonl").write_bytes(row("0", 9.0).as_line())
    for _ in range(2):
        merged = read_rows(tmp_path)
        counted = summarize(merged)
        by = {"model": "tiny", "model_sha256": "1" * 64, "version": "1.0", "inputs": 22}
        assert counted == Summary(22, 2, 20, 240, 18.5, (by,))
        assert {entry.input for entry in merged if entry.status == FAILED} == {"x", "y"}
        assert merge_manifests(tmp_path) == tmp_path / "manifest.jsonl"
        assert [path.name for path in tmp_path.iterdir()] == ["manifest.jsonl"]
    names = [entry.input for entry in read_rows(tmp_path)]
    assert names == sorted(entry.input for entry in rows)


def test_merging_refuses_a_manifest_with_a_cut_row(tmp_path: Path) -> None:
    filled(tmp_path, row("a"), row("b"), shard=Shard(1, 2))
    path = tmp_path / "manifest-1-of-2.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    with pytest.raises(UsageError, match="line 2"):
        merge_manifests(tmp_path)
    assert path.read_bytes() == whole[:-20]


def test_merging_waits_for_no_batch_at_work(tmp_path: Path) -> None:
    filled(tmp_path, row("a"))
    shard = Journal(tmp_path, Shard(1, 2))
    with pytest.raises(UsageError):
        merge_manifests(tmp_path)
    shard.finish([])


def test_missing_or_unreadable_manifest_is_refused(tmp_path: Path) -> None:
    for call in (read_rows, merge_manifests):
        with pytest.raises(UsageError):
            call(tmp_path)
    with pytest.raises(UsageError):
        read_rows(tmp_path / "manifest.jsonl")
