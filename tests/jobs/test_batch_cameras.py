"""A batch whose images have the cameras of a table."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.batches import images, outputs, request
from helpers.tiny import synthetic_image, write_image, write_model
from helpers.videos import flat_frames, write_video

from depthcli.core.camera import Intrinsics
from depthcli.errors import UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.table import Format
from depthcli.io.manifest import Shard
from depthcli.jobs.batch.plan import plan_files, plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest, dry_run
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.known.files import KnownDepthFiles
from depthcli.video.depth_video import DepthVideo

TABLE = "id,focal_px,hfov_deg\na,40,\nhall/b.png,,90\n"
KEPT = {"a.png": True, "z.png": True, "hall/b.png": True}


def with_table(
    folder: Path, table: str = TABLE, out: str = "out", options: BatchOptions | None = None
) -> BatchRequest:
    """A batch of the folder ``in`` with a table of cameras."""
    (folder / "cameras.csv").write_text(table)
    cameras = str(folder / "cameras.csv")
    plan = plan_folder(str(folder / "in"), str(folder / out), cameras=cameras)
    return replace(request(folder, out, options), plan=plan)


def kept(wanted: BatchRequest) -> dict[str, bool]:
    return {result.row.input: result.is_kept for result in Batch(wanted)}


def focal_px(path: Path) -> float:
    source = read_stored_depth(path).displayed.provenance
    assert source.focal_px is not None
    return source.focal_px


@pytest.mark.parametrize("batch_size", [1, 3])
def test_each_image_has_its_own_camera(tmp_path: Path, batch_size: int) -> None:
    images(tmp_path)
    table = "id,focal_px,hfov_deg,cx,cy\na,40,,3.5,-2\nhall/b.png,,90,,\nz,,,12,10\n"
    options = BatchOptions(
        (Format.NPY, Format.PNG16, Format.EXR, Format.PLY, Format.JSON),
        camera=Intrinsics(centre_px=(1.0, 2.0)),
    )
    job = replace(with_table(tmp_path, table, options=options), batch_size=batch_size)
    rows = {result.row.input: result.row for result in Batch(job)}
    assert {name: row.camera for name, row in rows.items()} == {
        "a.png": "hfov 43.6° (given)",
        "z.png": "hfov 60.0° (assumed, from the model's card)",
        "hall/b.png": "hfov 90.0° (given)",
    }
    facts = json.loads((tmp_path / "out/a.depth.json").read_text())
    assert (facts["focal_px"], facts["centre_px"]) == (40, [3.5, -2])
    assert facts["camera_source"] == "option"
    assert focal_px(tmp_path / "out/a.depth.png") == pytest.approx(40)
    cameras = {
        "a": Intrinsics(40.0, centre_px=(3.5, -2.0)),
        "hall/b": Intrinsics(hfov_deg=90.0, centre_px=(1.0, 2.0)),  # that of the batch
        "z": Intrinsics(centre_px=(12.0, 10.0)),
    }
    together = outputs(tmp_path / "out")
    for name, camera in cameras.items():
        list(Batch(request(tmp_path, "alone", replace(options, camera=camera))))
        for suffix in ("depth.npy", "depth.png", "depth.exr", "ply", "depth.json"):
            output = f"{name}.{suffix}"
            assert together[output] == (tmp_path / "alone" / output).read_bytes(), output
    assert all(kept(with_table(tmp_path, table, options=options)).values())
    moved = with_table(tmp_path, table.replace("-2", "-2.5"), options=options)
    assert kept(moved) == KEPT | {"a.png": False}


@pytest.mark.parametrize(
    ("table", "redone"),
    [
        (TABLE, set()),
        (TABLE + "z.png,,\n", set()),
        ("other,id,hfov_deg,focal_px\nx,./hall/b,90,\ny,a.png,,40.0\n", set()),
        ('other, id, "hfov_deg", focal_px\nx, ./hall/b, 90,\ny, "a.png", , 40\n', set()),
        (TABLE.replace("40", "41"), {"a.png"}),
        (TABLE.replace("a,40,", "a,,43.6"), {"a.png"}),
        (TABLE.replace("a,40,", "z,40,"), {"a.png", "z.png"}),
        (TABLE + "z,50\n", {"z.png"}),
    ],
)
def test_an_image_of_a_new_row_is_done_again(tmp_path: Path, table: str, redone: set[str]) -> None:
    images(tmp_path)
    assert not any(kept(with_table(tmp_path)).values())
    would = dry_run(with_table(tmp_path, table), request(tmp_path).model.load())
    assert {name for what, name, *_ in would if what == "do"} == redone
    assert kept(with_table(tmp_path, table)) == KEPT | dict.fromkeys(redone, False)
    assert all(kept(with_table(tmp_path, table)).values())


def test_images_without_a_row_are_those_of_a_batch_without_a_table(tmp_path: Path) -> None:
    images(tmp_path)
    list(Batch(request(tmp_path)))
    assert kept(with_table(tmp_path)) == {"a.png": False, "z.png": True, "hall/b.png": False}


def test_a_table_of_other_images_is_refused(tmp_path: Path) -> None:
    images(tmp_path)
    with pytest.raises(UsageError):
        with_table(tmp_path, "id,focal_px\nrgb/a,30\n")


def test_full_name_in_table_precedes_name_without_suffix(tmp_path: Path) -> None:
    images(tmp_path)
    (tmp_path / "in/a.jpg").write_bytes((tmp_path / "in/a.png").read_bytes())
    plan = with_table(tmp_path, "id,focal_px\na,30\na.png,40\n").plan
    assert {name: lens.focal_px for name, lens in plan.intrinsics.items()} == {
        "a.jpg": 30,
        "a.png": 40,
    }


def test_rows_of_other_shards_match(tmp_path: Path) -> None:
    images(tmp_path)
    with_table(tmp_path, TABLE + "z,30\n")
    lenses: dict[str, object] = {}
    for number in (1, 2):
        cameras = str(tmp_path / "cameras.csv")
        words = (str(tmp_path / "in"), str(tmp_path / "out"))
        plan = plan_folder(*words, shard=Shard(number, 2), cameras=cameras)
        assert list(plan.warnings) == []
        assert plan.intrinsics.keys() == {file.name for file in plan.inputs}
        lenses |= plan.intrinsics
    assert len(lenses) == 3


def test_a_video_has_its_own_camera(tmp_path: Path) -> None:
    write_video(tmp_path / "in/clip.mkv", flat_frames([60, 90]))
    table = "id,hfov_deg,cx,cy\nclip,90,3.5,-2\n"
    (result,) = Batch(with_table(tmp_path, table))
    assert result.row.camera == "hfov 90.0° (given)"
    depth = next(iter(DepthVideo(tmp_path / "out/clip.depth.mkv")))
    assert depth.provenance.centre_px == (3.5, -2)
    assert kept(with_table(tmp_path, table)) == {"clip.mkv": True}
    assert kept(with_table(tmp_path, table.replace("90", "91"))) == {"clip.mkv": False}


def test_a_model_without_a_camera_uses_them_for_point_clouds_alone(tmp_path: Path) -> None:
    write_image(tmp_path / "in/a.png", synthetic_image(24, 32))
    plain = SessionLoader(write_model(tmp_path / "plain"), "cpu")
    batch = Batch(replace(with_table(tmp_path), model=plain))
    (warning,) = (text for text in batch.warnings if "does not scale depth" in text)
    assert warning
    assert all("(given)" in str(result.row.camera) for result in batch)


@pytest.mark.parametrize(
    "table",
    [
        "",
        "a,40\n",
        "id,focal_px\na,40\nb,wide\n",
        "id,focal_px\na,-40\n",
        "id,hfov_deg\na,nan\n",
        "id,focal_px\n,40\n",
        "id,focal_px\na,40\na,41\n",
        "id,focal_px,cx\na,40,3\n",
        "id,focal_px,cx,cy\na,40,3,nan\n",
        "id,focal_px,cx,cy\na,40,3,4\na,40,3,5\n",
        'id,focal_px\n"a,40\nb,40\n',
        None,
    ],
)
def test_a_table_that_cannot_be_used(tmp_path: Path, table: str | None) -> None:
    path = tmp_path / "cameras.csv"
    if table is not None:
        path.write_text(table)
    with pytest.raises(UsageError):
        plan_files(["a.png"], "list", str(tmp_path), str(tmp_path / "out"), cameras=str(path))


def test_spaces_around_names_and_values_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "cameras.csv"
    path.write_text("id , focal_px ,cx , cy\n a ,40 , 3 ,4 \nb , , ,\n")
    words = (["a.png", "b.png"], "list", str(tmp_path), str(tmp_path / "out"))
    table = plan_files(*words, cameras=str(path)).intrinsics
    assert table == {"a.png": Intrinsics(40.0, None, (3.0, 4.0))}


def test_names_of_any_bytes_match(tmp_path: Path) -> None:
    (tmp_path / "cameras.csv").write_bytes(b'\xef\xbb\xbfid,focal_px\r\n"a, \xff\nb",40\r\n\r\n')
    name = "a, \udcff\nb.png"
    words = ([name], "list", str(tmp_path), str(tmp_path / "out"))
    plan = plan_files(*words, cameras=str(tmp_path / "cameras.csv"))
    assert plan.intrinsics[name].focal_px == 40


def test_known_depth_of_each_image_is_seen_by_its_own_camera(tmp_path: Path) -> None:
    """Clouds and distances along the ray, as of a lidar among several cameras."""
    trimesh = pytest.importorskip("trimesh")
    images(tmp_path)
    (tmp_path / "known" / "hall").mkdir(parents=True)
    cloud = trimesh.PointCloud([[0.5, 0, 2.0]])
    for name in ("a", "hall/b"):
        (tmp_path / "known" / f"{name}.ply").write_bytes(cloud.export(file_type="ply"))
    (tmp_path / "in" / "z.png").unlink()
    options = BatchOptions((Format.NPY,), anchors=KnownDepthFiles(str(tmp_path / "known")))
    table = "id,focal_px,cx,cy\na,40,10,12\nhall/b.png,80,11,13\n"
    list(Batch(with_table(tmp_path, table, options=options)))
    for name, (x, y) in {"a": (20, 12), "hall/b": (31, 13)}.items():
        depth_m = np.load(tmp_path / f"out/{name}.depth.npy")
        assert depth_m[y, x] == pytest.approx(2)
