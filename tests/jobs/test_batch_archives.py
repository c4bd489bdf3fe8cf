"""Batches of tar shards (webdataset) and of Parquet with images inside (Hugging Face)."""

import json
import tarfile
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from helpers.command_line import Cli
from helpers.folders import rows
from helpers.tiny import synthetic_picture


def png(seed: int) -> bytes:
    return cv2.imencode(".png", synthetic_picture(24, 32 + seed))[1].tobytes()


def write_tar(path: Path, files: dict[str, bytes]) -> None:
    with tarfile.open(path, "w") as archive:
        for name, data in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            archive.addfile(entry, BytesIO(data))


def read_tar(path: Path) -> dict[str, bytes]:
    with tarfile.open(path) as archive:
        opened = ((entry.name, archive.extractfile(entry)) for entry in archive)
        return {name: file.read() for name, file in opened if file}


def predicted(cli: Cli, seed: int) -> bytes:
    (cli.folder / "one.png").write_bytes(png(seed))
    assert cli("predict", "one.png", "-o", "one.depth.png").returncode == 0
    return (cli.folder / "one.depth.png").read_bytes()


def test_shard_becomes_a_shard_of_depth_with_its_keys(inside: Cli) -> None:
    files = {"a/1.png": png(1), "a/1.mask.png": png(5), "a/1.json": b"{}", "2.png": png(2)}
    write_tar(inside.folder / "s.tar", files)
    done = inside("batch", "s.tar", "--out", "out", "--format", "png16", "--format", "npy")
    assert done.returncode == 0
    found = read_tar(inside.folder / "out" / "s.depth.tar")
    assert [*found] == ["a/1.depth.png", "a/1.depth.npy", "2.depth.png", "2.depth.npy"]
    assert found["2.depth.png"] == predicted(inside, 2)
    before = (inside.folder / "out" / "s.depth.tar").read_bytes()
    again = inside(
        "batch", "s.tar", "--out", "out", "--format", "npy", "--format", "png16", "--json"
    )
    assert json.loads(again.stdout)["kept"]
    other = inside("batch", "s.tar", "--out", "other", "--column", "mask.png")
    assert other.returncode == 0
    assert [*read_tar(inside.folder / "other" / "s.depth.tar")] == ["a/1.mask.depth.png"]
    assert (inside.folder / "out" / "s.depth.tar").read_bytes() == before


def test_failed_image_of_a_shard_costs_no_other(inside: Cli) -> None:
    write_tar(inside.folder / "s.tar", {"1.png": png(1)[:40], "2.png": png(2)})
    assert inside("batch", "s.tar", "--out", "out").returncode == 1
    assert [*read_tar(inside.folder / "out" / "s.depth.tar")] == ["2.depth.png"]
    (row,) = rows(inside, "out").values()
    assert (row["status"], "1.png" in row["error"]) == ("failed", True)


@pytest.mark.parametrize("files", [{}, {"1.txt": b"x"}, {"1.png": b"x"}])
def test_shard_without_a_readable_image_is_an_error(inside: Cli, files: dict[str, bytes]) -> None:
    write_tar(inside.folder / "s.tar", files)
    assert inside("batch", "s.tar", "--out", "out").returncode == 1
    assert not (inside.folder / "out" / "s.depth.tar").exists()


def test_rows_of_parquet_keep_their_place(inside: Cli) -> None:
    kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    images = [{"bytes": png(1), "path": "a.png"}, {"bytes": b"x", "path": "b.png"}]
    images.append({"bytes": png(2), "path": None})
    table = pa.table({"image": pa.array(images, kind), "caption": ["x", "y", "z"]})
    pq.write_table(table, inside.folder / "hf.parquet")
    done = inside("batch", "--files", "hf.parquet", "--column", "image", "--out", "out")
    assert done.returncode == 1
    depth = pq.read_table(inside.folder / "out" / "hf.depth.parquet")["depth"].to_pylist()
    assert [row and row["path"] for row in depth] == ["a.depth.png", None, "000002.depth.png"]
    assert depth[0]["bytes"] == predicted(inside, 1)
    stored = cv2.imdecode(np.frombuffer(depth[2]["bytes"], np.uint8), cv2.IMREAD_UNCHANGED)
    assert (stored.dtype, stored.shape) == (np.uint16, (24, 34))


def test_list_of_paths_may_have_columns_of_bytes(inside: Cli) -> None:
    (inside.folder / "1.png").write_bytes(png(1))
    table = pa.table({"path": ["1.png"], "hash": pa.array([b"x"], pa.large_binary())})
    pq.write_table(table, inside.folder / "p.parquet")
    assert inside("batch", "--files", "p.parquet", "-o", "out").returncode == 0
    assert rows(inside, "out").keys() == {"1.png"}


def test_several_columns_of_images_need_a_name(inside: Cli) -> None:
    table = pa.table({name: pa.array([png(1)], pa.binary()) for name in ("left", "right")})
    pq.write_table(table, inside.folder / "p.parquet")
    assert inside("batch", "p.parquet", "--out", "out").returncode == 2
    assert inside("batch", "p.parquet", "--out", "out", "--column", "left").returncode == 0


def test_folder_of_shards_alone_is_read_and_its_tree_is_kept(inside: Cli) -> None:
    (inside.folder / "in" / "train").mkdir(parents=True)
    write_tar(inside.folder / "in" / "train" / "0.tar", {"1.png": png(1)})
    write_tar(inside.folder / "in" / "1.tar", {"2.png": png(2)})
    (inside.folder / "in" / "notes.txt").touch()
    assert inside("batch", "in", "-o", "out").returncode == 0
    assert rows(inside, "out").keys() == {"train/0.tar", "1.tar"}
    assert (inside.folder / "out" / "train" / "0.depth.tar").exists()
    (inside.folder / "in" / "a.png").write_bytes(png(3))
    assert inside("batch", "in", "-o", "other").returncode == 0
    assert rows(inside, "other").keys() == {"a.png"}
