"""``depthcli convert DIR --out OUT``: a whole folder of depth files."""

from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.folders import contents, printed
from helpers.stores import Bucket
from helpers.tiny import write_picture

from depthcli.core.types import DepthMap
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.npy import NpyWriter
from depthcli.io.formats.png16 import Png16Writer
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.sidecar import SidecarWriter
from depthcli.io.formats.table import Format
from depthcli.io.listing.folder import NameFilter
from depthcli.jobs.convert import (
    ConvertRequest,
    ConvertResult,
    convert_folder,
    plan_folder,
)

TO_EXR = ("convert", "in", "--out", "out", "--format", "exr")


def depth_file(path: Path, depth_m: float = 2.0) -> Path:
    """A depth file of one depth, as PNG or NPY by its suffix."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = NpyWriter() if path.suffix == ".npy" else Png16Writer()
    writer.write(DepthMap(np.full((6, 8), depth_m, np.float32)), path)
    return path


@pytest.fixture
def tree(inside: Cli) -> Cli:
    """A folder of three depth files, one in a subfolder, and of what lies beside them."""
    root = inside.folder / "in"
    depth_file(root / "a.depth.png", 1)
    depth_file(root / "b.png", 2)
    depth_file(root / "hall/c.npy", 3.5)
    PreviewWriter().write(DepthMap(np.ones((6, 8), np.float32)), root / "a.preview.png")
    SidecarWriter().write(DepthMap(np.ones((6, 8), np.float32)), root / "a.depth.json")
    (root / ".hidden.npy").write_bytes(b"")
    return inside


def names(folder: Path, wanted: Format = Format.EXR) -> dict[str, str]:
    """The output of each input of the folder ``in``."""
    request = ConvertRequest(f"{folder}/in", f"{folder}/out", wanted)
    plan = plan_folder(request)
    outputs = [target.removeprefix(f"{folder}/out/") for target in plan.targets]
    return dict(zip((file.name for file in plan.inputs), outputs, strict=True))


def test_a_tree_is_kept(tree: Cli) -> None:
    done = tree(*TO_EXR)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(b"3 of 3 files converted, 3 files skipped (")
    assert b"1 preview" in done.stdout
    assert done.stdout.endswith(b"; round trip: max error 0 m, 0 pixels lost\n")
    outputs = contents(tree, "out")
    assert outputs.keys() == {"a.depth.exr", "b.depth.exr", "hall/c.depth.exr"}
    for name, depth_m in (("a", 1), ("b", 2), ("hall/c", 3.5)):
        depth = read_stored_depth(tree.folder / "out" / f"{name}.depth.exr").displayed
        assert (depth.values == depth_m).all()
    before = {name: (tree.folder / "out" / name).stat().st_ino for name in outputs}
    depth_file(tree.folder / "in/b.png", 4)
    assert tree(*TO_EXR, "--workers", "1").returncode == 0
    after = contents(tree, "out")
    assert {name for name in after if after[name] != outputs[name]} == {"b.depth.exr"}
    assert all((tree.folder / "out" / name).stat().st_ino != before[name] for name in before)


def test_no_bad_file_stops_the_other_conversions(tree: Cli) -> None:
    write_picture(tree.folder / "in/0.png")
    (tree.folder / "in/hall/b.npy").write_bytes(b"")
    (tree.folder / "in/loop").symlink_to(".")
    (tree.folder / "in/velodyne.bin").write_bytes(b"points")
    np.save(tree.folder / "in/z.npy", np.ones((6, 8), np.uint16))
    done = tree(*TO_EXR)
    assert done.returncode == 1
    lines = done.stderr.decode().splitlines()
    assert [line.split(": ")[2].split()[0] for line in lines] == [
        *("loop", "in/0.png", "in/z.npy", "in/hall/b.npy"),
    ]
    assert done.stdout.startswith(b"3 of 6 files converted, 3 failed, 4 files skipped")
    assert len(contents(tree, "out")) == 3
    told = {line["input"]: line for line in printed(tree(*TO_EXR, "--json"))}
    assert [name for name, line in told.items() if line["status"] == "failed"] == [
        *("in/0.png", "in/z.npy", "in/hall/b.npy"),
    ]
    assert told["in/b.png"] == {
        "input": "in/b.png",
        "status": "ok",
        "output": "out/b.depth.exr",
        "unit": "m",
        "max_error": 0.0,
        "mean_error": 0.0,
        "lost": 0,
        "warnings": [],
    }
    quiet = tree(*TO_EXR, "--quiet")
    assert (quiet.returncode, quiet.stdout, quiet.stderr.count(b"\n")) == (1, b"", 3)


def test_names_of_conversions_do_not_collide(tmp_path: Path) -> None:
    given = ("a.depth.png", "a.npy", "b.depth.npy", "B.png", "c.npy", "c.npy.exr", "d.png", "D.png")
    (tmp_path / "in").mkdir()
    for name in given:
        (tmp_path / "in" / name).write_bytes(b"")
    found = names(tmp_path)
    assert len({name.casefold() for name in found.values()}) == len(given)
    assert found["a.depth.png"] == "a.depth.png.depth.exr"
    assert found["a.npy"] == "a.npy.depth.exr"
    assert found["c.npy"] == "c.depth.exr"
    assert found["c.npy.exr"] == "c.npy.exr.depth.exr"
    assert found["d.png"] != "d.depth.exr" != found["D.png"]


@pytest.mark.parametrize(
    ("wanted", "suffix"), [(Format.EXR, "exr"), (Format.PLY, "ply"), (Format.PNG16, "png")]
)
def test_numbered_files_stay_numbered(tmp_path: Path, wanted: Format, suffix: str) -> None:
    depth_file(tmp_path / "in/clip.depth.000001.npy")
    assert names(tmp_path, wanted) == {
        "clip.depth.000001.npy": f"clip.depth.000001.{suffix}",
    }


def test_patterns_choose_and_change_no_name(tree: Cli) -> None:
    depth_file(tree.folder / "in/b.npy")
    done = tree(*TO_EXR, "--include", "*.png", "--exclude", "a.*")
    assert done.returncode == 0
    assert contents(tree, "out").keys() == {"b.png.depth.exr"}
    assert tree(*TO_EXR, "--include", "*.exr").returncode == 2


def test_an_output_folder_within_the_folder_is_not_read(tree: Cli) -> None:
    words = ("convert", "in", "--out", "in/exr", "--format", "exr", "--json")
    assert len(printed(tree(*words))) == len(printed(tree(*words))) == 3


def test_no_input_is_replaced_by_a_conversion(tree: Cli) -> None:
    target = depth_file(tree.folder / "out/b.depth.png", 5)
    (tree.folder / "in/other.png").symlink_to(target)
    before = contents(tree, ".")
    assert tree("convert", "in", "--out", "out", "--format", "png16").returncode == 2
    assert contents(tree, ".") == before


def test_folders_of_a_bucket(tmp_path: Path, bucket: Bucket) -> None:
    data = depth_file(tmp_path / "a.npy", 3).read_bytes()
    for key in ("in/z.npy", "in/hall/a.npy", "in/notes.txt"):
        bucket.put(key, data)
    wanted = NameFilter.of((), ("none",))
    request = ConvertRequest(bucket.uri("in"), bucket.uri("out"), Format.PNG16)
    plan = plan_folder(request, wanted)
    assert [file.name for file in plan.inputs] == ["z.npy", "hall/a.npy"]
    results = list(convert_folder(request, plan))
    assert all(isinstance(result, ConvertResult) for result in results)
    made = {key for key in bucket.names() if key.startswith("out/")}
    assert made == {"out/z.depth.png", "out/hall/a.depth.png"}
    assert [file.reason for file in plan.skipped] == [".txt"]
