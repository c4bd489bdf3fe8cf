"""``depthcli manifest``, as a user runs it."""

import json

from helpers.command_line import Cli
from helpers.folders import contents, printed, tree


def test_shards_are_summed_up_listed_and_merged(inside: Cli) -> None:
    tree(inside, "a.png", "hall/b.png")
    (inside.folder / "in" / "bad\tname.png").touch()
    codes = [inside("batch", "in", "-o", "out", "--shard", f"{n}/2").returncode for n in (1, 2)]
    assert sorted(codes) == [0, 1]
    said = inside("manifest", "summary", "out").stdout.decode().splitlines()
    assert said[0] == "3 inputs: 2 ok, 1 failed"
    assert said[1].startswith("2 outputs, ")
    (found,) = printed(inside("manifest", "summary", "out", "--json"))
    assert (found["inputs"], found["failed"], found["outputs"]) == (3, 1, 2)
    assert [one["inputs"] for one in found["models"]] == [3]
    assert {"model", "model_sha256", "version"} < set(found["models"][0])
    failed = inside("manifest", "failed", "out")
    assert failed.stdout.decode().count("\n") == 1
    assert "is empty" in failed.stdout.decode()
    (row,) = printed(inside("manifest", "failed", "out", "--json"))
    assert (row["input"], row["status"]) == ("bad\tname.png", "failed")
    merged = printed(inside("manifest", "merge", "out", "--json"))
    assert merged == [{"manifest": "out/manifest.jsonl"}]
    left = {name.split("/")[0] for name in contents(inside, "out")}
    assert left == {"a.depth.png", "hall", "manifest.jsonl"}
    assert json.loads(inside("manifest", "summary", "out", "--json").stdout) == found
