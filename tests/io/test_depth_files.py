"""Depth files of other tools, and what is no depth file."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from helpers.command_line import unmeasured
from helpers.plates import depth_channel

from depthcli.core.types import DepthMap
from depthcli.errors import InputError
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.formats.exr import ExrWriter

DEPTH_M = np.linspace(0.5, 9, 12, dtype=np.float32).reshape(3, 4)
SCANLINES = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["R", "G", "B", "A", "depth.Z"], "depth.Z"),
        (["ViewLayer.Normal.Z", "ViewLayer.Depth.Z"], "ViewLayer.Depth.Z"),
        (["View Layer.Depth.V", "View Layer.Combined.R"], "View Layer.Depth.V"),
        (["depth.R", "depth.G"], "depth.R"),
        (["rgba.R", "other.Y"], "other.Y"),
        (["Z", "depth.Z"], "Z"),
        (["R", "N.X", "N.Y", "N.Z"], "R"),
        (["P.R", "P.X", "P.Y", "P.Z"], None),
        (["ViewLayer.UV.U", "ViewLayer.UV.V"], None),
        (["X", "Y", "Z", "far.Z"], "far.Z"),
        (["V"], "V"),
        (["B", "A"], None),
        (["X", "W"], None),
        ([], None),
    ],
)
def test_depth_is_found_among_colours_and_normals(names: list[str], expected: str | None) -> None:
    assert depth_channel(names) == expected
    assert depth_channel(names[::-1]) == expected


def test_exr_of_several_parts(tmp_path: Path) -> None:
    parts = [
        OpenEXR.Part({**SCANLINES, "name": name}, {channel: DEPTH_M * factor})
        for name, channel, factor in [("rgba", "R", 2), ("depth", "Z", 1), ("normal", "Z", 3)]
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_stored_depth(tmp_path / "a.exr").displayed.values, DEPTH_M)


def test_a_colour_exr_is_no_depth(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    gray = dict.fromkeys("RGB", DEPTH_M)
    OpenEXR.File(SCANLINES, gray).write(str(path))
    np.testing.assert_array_equal(read_stored_depth(path).displayed.values, DEPTH_M)
    OpenEXR.File(SCANLINES, {**gray, "G": DEPTH_M + 1}).write(str(path))
    with pytest.raises(InputError):
        read_stored_depth(path)


def test_exr_on_a_disk_that_is_full_for_a_moment_is_one_clear_error(tmp_path: Path) -> None:
    script = (
        "import resource, signal, sys; from pathlib import Path; import numpy as np\n"
        "from depthcli.core.types import DepthMap\n"
        "from depthcli.io.storage.atomic import atomic_path\n"
        "from depthcli.io.formats.exr import ExrWriter\n"
        "noise = np.random.default_rng(0).random((24, 24), np.float32)\n"
        "allow = lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, -1))\n"
        "signal.signal(signal.SIGXFSZ, lambda *_: allow(-1)); allow(1000)\n"
        "with atomic_path(Path(sys.argv[1])) as path: ExrWriter().write(DepthMap(noise), path)\n"
    )
    words = [sys.executable, "-c", script, tmp_path / "a.exr"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=unmeasured())
    assert done.stderr.splitlines()[-1].endswith(
        f"{tmp_path}/a.exr: File too large; choose another path"
    )
    assert list(tmp_path.iterdir()) == []


def test_overflow_of_half_floats_is_a_warning(tmp_path: Path) -> None:
    depth = DepthMap(np.array([[1, 70_000, np.inf]], np.float32))
    with np.errstate(over="raise"):  # NumPy's own warning would be a second one
        warnings = ExrWriter(half=True).write(depth, tmp_path / "a.exr")
    assert warnings == ("1 pixels are beyond half floats and became infinite",)
    values = read_stored_depth(tmp_path / "a.exr").displayed.values
    np.testing.assert_array_equal(values, [[1, np.nan, np.nan]])


@pytest.mark.parametrize(
    ("shape", "expected"),
    [((1, 1, 5), (1, 5)), ((5, 1, 1), (5, 1)), ((1, 3, 4), (3, 4)), ((1, 1), (1, 1))],
)
def test_npy_with_batch_or_channel_axes(
    shape: tuple[int, ...], expected: tuple[int, int], tmp_path: Path
) -> None:
    np.save(tmp_path / "a.npy", np.ones(shape, np.float64))
    depth = read_stored_depth(str(tmp_path / "a.npy")).displayed
    assert (depth.values.shape, depth.values.dtype) == (expected, np.float32)


@pytest.mark.parametrize(
    "values",
    [
        np.ones((2, 3, 4)),
        np.ones(5),
        np.ones((0, 4)),
        np.ones((2, 2), bool),
        np.ones((2, 2), complex),
        np.array([[object()]]),
    ],
    ids=["three axes", "one axis", "no pixels", "bool", "complex", "objects"],
)
def test_arrays_that_are_no_depth(values: np.ndarray, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", values, allow_pickle=True)
    with pytest.raises(InputError):
        read_stored_depth(tmp_path / "a.npy")


@pytest.mark.parametrize("name", ["a.png", "a.exr", "a.npy"])
@pytest.mark.parametrize(
    "content", [b"", b"no depth at all", None], ids=["empty", "text", "missing"]
)
def test_damaged_and_foreign_files_are_refused(
    name: str, content: bytes | None, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_stored_depth(tmp_path / name)
    assert caught.value.message.count(name) == 1
    assert caught.value.message.count("\n") == 0
    if name == "a.exr":
        with pytest.raises(InputError):
            read_metadata(tmp_path / name)
