"""A batch in parts that run at the same time into one folder."""

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batches import NAMES, kept, outputs, pictures, request
from helpers.tiny import synthetic_picture, write_picture

from depthcli.errors import UsageError
from depthcli.io.formats.table import Format
from depthcli.io.manifest import Shard, known_rows
from depthcli.jobs.batch.plan import plan_files, plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import TaskBuilder

COUNT = 3


def shard_request(folder: Path, number: int, out: str = "out", count: int = COUNT) -> BatchRequest:
    shard = Shard(number, count)
    plan = plan_folder(str(folder / "in"), str(folder / out), shard=shard)
    return replace(request(folder, out), plan=plan)


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.is_file() and path.suffix == ".jsonl"}


def test_shards_at_the_same_time_are_the_whole(tmp_path: Path) -> None:
    pictures(tmp_path)
    for number in range(6):
        write_picture(tmp_path / "in" / f"{number}.png", synthetic_picture(24, 40 + number))
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
    pictures(tmp_path)
    one, other = Batch(shard_request(tmp_path, 1)), Batch(shard_request(tmp_path, 2))
    for refused in (shard_request(tmp_path, 1), request(tmp_path)):
        with pytest.raises(UsageError):
            Batch(refused)
    one.close()
    other.close()
    whole = Batch(request(tmp_path))
    with pytest.raises(UsageError):
        Batch(shard_request(tmp_path, 1))
    whole.close()


def test_a_killed_shard_goes_on_and_touches_no_other_s_files(tmp_path: Path) -> None:
    pictures(tmp_path)
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
    picture, its_output = "a.jpg", "a.depth.png"
    numbers = [n for n in (1, 2, 3) if Shard(n, 3).holds(picture)]
    assert not Shard(numbers[0], 3).holds(its_output)
    for name in (picture, its_output):
        write_picture(tmp_path / name)
    for shard in (Shard(), Shard(numbers[0], 3)):
        plan = plan_files([picture, its_output], "mine", *[str(tmp_path)] * 2, shard=shard)
        with pytest.raises(UsageError):
            TaskBuilder(plan, (Format.PNG16,)).check_conflicts()


def test_skipped_file_is_counted_by_one_shard(tmp_path: Path) -> None:
    pictures(tmp_path)
    for number in range(9):
        (tmp_path / "in" / f"{number}.txt").touch()
    told = [shard_request(tmp_path, number + 1).plan.skipped for number in range(COUNT)]
    assert all(told), "a shard that skips nothing shows nothing"
    whole = request(tmp_path).plan.skipped
    assert sorted(file.name for part in told for file in part) == [file.name for file in whole]


def test_a_shard_without_inputs_is_done(tmp_path: Path) -> None:
    pictures(tmp_path)
    empty = next(n for n in range(1, 9) if not any(map(Shard(n, 8).holds, NAMES)))
    assert list(Batch(shard_request(tmp_path, empty, count=8))) == []
