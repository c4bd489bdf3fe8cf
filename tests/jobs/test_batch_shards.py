"""Parts of a batch, and data sets in archives."""

import json
import tarfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from helpers.batches import NAMES, images, kept, outputs, request
from helpers.command_line import Cli
from helpers.folders import rows
from helpers.tiny import synthetic_image, write_image

from depthcli.errors import UsageError
from depthcli.io.manifest import Shard, known_rows
from depthcli.jobs.batch.plan import plan_files, plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import BatchOptions, TaskBuilder

COUNT = 3


def shard_request(folder: Path, number: int, out: str = "out", count: int = COUNT) -> BatchRequest:
    shard = Shard(number, count)
    plan = plan_folder(str(folder / "in"), str(folder / out), shard=shard)
    return replace(request(folder, out), plan=plan)


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.is_file() and path.suffix == ".jsonl"}


def test_shards_at_the_same_time_are_the_whole(tmp_path: Path) -> None:
    images(tmp_path)
    for number in range(6):
        write_image(tmp_path / "in" / f"{number}.png", synthetic_image(24, 40 + number))
    (tmp_path / "in" / "z.jpg").write_bytes((tmp_path / "in" / "z.png").read_bytes())
    batches = [Batch(shard_request(tmp_path, number + 1)) for number in range(COUNT)]
    results = [list(batch) for batch in batches]
    inputs = [result.row.input for part in results for result in part]
    whole = list(Batch(request(tmp_path, "whole")))
    assert sorted(inputs) == sorted(result.row.input for result in whole)
    assert all(results), "a shard without inputs shows nothing"
    manifests = {f"manifest-{number}-of-{COUNT}.jsonl" for number in range(1, COUNT + 1)}
    assert files(tmp_path / "out") == manifests
    assert {n: d for n, d in outputs(tmp_path / "out").items() if n not in manifests} == outputs(
        tmp_path / "whole"
    )
    again = [result for n in range(COUNT) for result in Batch(shard_request(tmp_path, n + 1))]
    other_count = [result for n in (1, 2) for result in Batch(shard_request(tmp_path, n, count=2))]
    for redone in (again, other_count):
        assert len(redone) == len(inputs)
        assert all(result.is_kept for result in redone)
    assert all(kept(tmp_path).values())
    assert files(tmp_path / "out") == {"manifest.jsonl"}


def test_a_shard_and_a_whole_batch_keep_each_other_out(tmp_path: Path) -> None:
    images(tmp_path)
    first, other = Batch(shard_request(tmp_path, 1)), Batch(shard_request(tmp_path, 2))
    for refused in (shard_request(tmp_path, 1), request(tmp_path)):
        with pytest.raises(UsageError):
            Batch(refused)
    first.close()
    other.close()
    whole = Batch(request(tmp_path))
    with pytest.raises(UsageError):
        Batch(shard_request(tmp_path, 1))
    whole.close()


def test_a_killed_shard_goes_on_and_touches_no_other_s_files(tmp_path: Path) -> None:
    images(tmp_path)
    numbers = {name: n for n in (1, 2) for name in NAMES if Shard(n, 2).holds(name)}
    batch = Batch(shard_request(tmp_path, numbers["a.png"], count=2))
    assert {result.row.input for result in batch} == {n for n in NAMES if numbers[n] == 1}
    done = shard_request(tmp_path, 1, count=2).plan
    assert known_rows(tmp_path / "out", done.shard).row("a.png") is not None
    manifest = tmp_path / "out" / "manifest-1-of-2.jsonl"
    manifest.rename(tmp_path / "out" / ".depthcli-batch-1-of-2.jsonl")  # as if it had been killed
    half = tmp_path / "out" / ".depthcli-0123456789abcdef.png"
    deeper = tmp_path / "out" / "hall" / half.name
    deeper.parent.mkdir(exist_ok=True)
    for path in (half, deeper):
        path.write_bytes(b"of another shard that is at work")
    assert all(result.is_kept for result in Batch(shard_request(tmp_path, 1, count=2)))
    assert half.exists()
    assert deeper.exists()
    assert manifest.exists()
    list(Batch(shard_request(tmp_path, 2, count=2)))
    manifest.rename(tmp_path / "out" / ".depthcli-batch-1-of-2.jsonl")
    assert all(kept(tmp_path).values())
    assert not half.exists()
    assert not deeper.exists()
    assert files(tmp_path / "out") == {"manifest.jsonl"}


def test_a_shard_replaces_no_input_of_another(tmp_path: Path) -> None:
    image, its_output = "a.jpg", "a.depth.png"
    numbers = [n for n in (1, 2, 3) if Shard(n, 3).holds(image)]
    assert not Shard(numbers[0], 3).holds(its_output)
    for name in (image, its_output):
        write_image(tmp_path / name)
    for shard in (Shard(), Shard(numbers[0], 3)):
        plan = plan_files([image, its_output], "mine", *[str(tmp_path)] * 2, shard=shard)
        with pytest.raises(UsageError):
            TaskBuilder(plan, BatchOptions()).check_conflicts()


def test_skipped_file_is_counted_by_one_shard(tmp_path: Path) -> None:
    images(tmp_path)
    for number in range(9):
        (tmp_path / "in" / f"{number}.txt").touch()
    skipped = [shard_request(tmp_path, number + 1).plan.skipped for number in range(COUNT)]
    assert all(skipped), "a shard that skips nothing shows nothing"
    whole = request(tmp_path).plan.skipped
    assert sorted(file.name for part in skipped for file in part) == [file.name for file in whole]


def test_a_shard_without_inputs_is_done(tmp_path: Path) -> None:
    images(tmp_path)
    empty = next(n for n in range(1, 9) if not any(map(Shard(n, 8).holds, NAMES)))
    assert list(Batch(shard_request(tmp_path, empty, count=8))) == []


def png(seed: int) -> bytes:
    return cv2.imencode(".png", synthetic_image(24, 32 + seed))[1].tobytes()


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
    inside("batch", "s.tar", "--out", "out", "--format", "png16", "--format", "npy", code=0)
    members = read_tar(inside.folder / "out" / "s.depth.tar")
    assert [*members] == ["a/1.depth.png", "a/1.depth.npy", "2.depth.png", "2.depth.npy"]
    assert members["2.depth.png"] == predicted(inside, 2)
    before = (inside.folder / "out" / "s.depth.tar").read_bytes()
    again = inside(
        "batch", "s.tar", "--out", "out", "--format", "npy", "--format", "png16", "--json"
    )
    assert json.loads(again.stdout)["kept"]
    inside("batch", "s.tar", "--out", "other", "--column", "mask.png", code=0)
    assert [*read_tar(inside.folder / "other" / "s.depth.tar")] == ["a/1.mask.depth.png"]
    assert (inside.folder / "out" / "s.depth.tar").read_bytes() == before


def test_failed_image_of_a_shard_costs_no_other(inside: Cli) -> None:
    write_tar(inside.folder / "s.tar", {"1.png": png(1)[:40], "2.png": png(2)})
    assert inside("batch", "s.tar", "--out", "out").returncode == 1
    assert [*read_tar(inside.folder / "out" / "s.depth.tar")] == ["2.depth.png"]
    (row,) = rows(inside, "out").values()
    assert (row["status"], "1.png" in row["error"]) == ("failed", True)


@pytest.mark.parametrize("files", [{}, {"1.rgb.png": b"x"}, {"1.png": b"x"}])
def test_shard_without_a_readable_image_is_an_error(inside: Cli, files: dict[str, bytes]) -> None:
    write_tar(inside.folder / "s.tar", files)
    assert inside("batch", "s.tar", "--out", "out").returncode == 1
    assert not (inside.folder / "out" / "s.depth.tar").exists()
    (row,) = rows(inside, "out").values()
    assert ("give column" in row["error"]) == ("1.png" not in files)


@pytest.mark.parametrize("more", [0, 300])  # of the next header
def test_shard_cut_off_between_members_is_damaged(inside: Cli, more: int) -> None:
    """As in BobBuildTool/bob#636: Python's tarfile takes what is there for all of it."""
    path = inside.folder / "s.tar"
    write_tar(path, {"1.png": png(1), "2.png": png(2)})
    with tarfile.open(path) as archive:
        end = archive.getmember("2.png").offset
    path.write_bytes(path.read_bytes()[: end + more])
    assert inside("batch", "s.tar", "--out", "out").returncode == 1
    assert not (inside.folder / "out" / "s.depth.tar").exists()


def test_keys_of_a_shard_that_tar_made_of_a_folder_are_kept(inside: Cli) -> None:
    """``tar cf s.tar -C DIR .`` puts "./" before all names, which webdataset keeps."""
    write_tar(inside.folder / "s.tar", {"./a.b/1.png": png(1)})
    inside("batch", "s.tar", "--out", "out", code=0)
    assert [*read_tar(inside.folder / "out" / "s.depth.tar")] == ["./a.b/1.depth.png"]


def test_rows_of_parquet_keep_their_place(inside: Cli) -> None:
    kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    images = [{"bytes": png(1), "path": "a.png"}, {"bytes": b"x", "path": "b.png"}]
    images.append({"bytes": png(2), "path": None})
    table = pa.table({"image": pa.array(images, kind), "caption": ["x", "y", "z"]})
    pq.write_table(table, inside.folder / "hf.parquet")
    inside("batch", "--files", "hf.parquet", "--column", "image", "--out", "out", code=1)
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
    assert b"--column" in inside("batch", "p.parquet", "--out", "out", code=1).stderr
    assert inside("batch", "p.parquet", "--out", "out", "--column", "left").returncode == 0


def test_folder_of_shards_alone_is_read_and_its_tree_is_kept(inside: Cli) -> None:
    (inside.folder / "in" / "train").mkdir(parents=True)
    write_tar(inside.folder / "in" / "train" / "0.tar", {"1.png": png(1)})
    write_tar(inside.folder / "in" / "1.tar", {"2.png": png(2)})
    (inside.folder / "in" / "notes.txt").touch()
    assert inside("batch", "in", "-o", "out").returncode == 0
    assert rows(inside, "out").keys() == {"train/0.tar", "1.tar"}
    assert (inside.folder / "out" / "train" / "0.depth.tar").exists()
    assert inside("batch", "in", "-o", "in/one").returncode == 0
    assert inside("batch", "in", "-o", "in/two").returncode == 0
    assert rows(inside, "in/two").keys() == {"train/0.tar", "1.tar"}
    pq.write_table(pa.table({"width": [1]}), inside.folder / "in" / "facts.parquet")
    (inside.folder / "in" / "cut.parquet").write_bytes(b"PAR1")
    inside("batch", "in", "-o", "again", code=1)
    results = {name: row["status"] for name, row in rows(inside, "again").items()}
    good = {"1.tar": "ok", "train/0.tar": "ok"}
    assert results == {"facts.parquet": "failed", "cut.parquet": "failed", **good}
    (inside.folder / "in" / "a.png").write_bytes(png(3))
    assert inside("batch", "in", "-o", "other").returncode == 0
    assert rows(inside, "other").keys() == {"a.png"}
