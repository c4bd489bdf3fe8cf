"""Depth files of other tools, and what is no depth file."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import OpenEXR
import pytest
from helpers import made
from helpers.command_line import unmeasured
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.core.types import DepthKind, DepthMap, Provenance
from depthcli.errors import InputError
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.exr.layers import depth_channel
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.png16 import Png16Writer
from depthcli.io.formats.sidecar import SidecarWriter
from depthcli.io.formats.table import FORMATS, Format, writer_class
from depthcli.io.images.png import encode_png

DEPTH_M = np.linspace(0.5, 9, 12, dtype=np.float32).reshape(3, 4)
SCANLINES = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}


def png16(steps: np.ndarray) -> bytes:
    ok, data = cv2.imencode(".png", steps.astype(np.uint16))
    assert ok
    return data.tobytes()


@pytest.mark.parametrize(
    ("names", "wanted"),
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
        (["X", "W"], None),
        ([], None),
    ],
)
def test_depth_is_found_among_colours_and_normals(names: list[str], wanted: str | None) -> None:
    assert depth_channel(names) == wanted
    assert depth_channel(names[::-1]) == wanted


def test_exr_of_several_parts(tmp_path: Path) -> None:
    parts = [
        OpenEXR.Part({**SCANLINES, "name": name}, {channel: DEPTH_M * factor})
        for name, channel, factor in [("rgba", "R", 2), ("depth", "Z", 1), ("normal", "Z", 3)]
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_stored_depth(tmp_path / "a.exr").displayed.values, DEPTH_M)


@pytest.mark.parametrize("corner", [(2, 1), (-1, -1), (-20, 0)])
def test_exr_keeps_the_framing(corner: tuple[int, int], tmp_path: Path) -> None:
    left, top = corner
    windows = {
        "displayWindow": (np.array([0, 0], np.int32), np.array([7, 5], np.int32)),
        "dataWindow": (np.array(corner, np.int32), np.array([left + 3, top + 2], np.int32)),
    }
    OpenEXR.File({**SCANLINES, **windows}, {"Z": DEPTH_M}).write(str(tmp_path / "a.exr"))
    found = read_stored_depth(tmp_path / "a.exr").displayed.values
    whole = np.full((6, 8), np.nan, np.float32)
    for row in range(6):
        for column in range(8):
            if 0 <= row - top < 3 and 0 <= column - left < 4:
                whole[row, column] = DEPTH_M[row - top, column - left]
    np.testing.assert_array_equal(found, whole)


def test_a_colour_exr_is_no_depth(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    gray = dict.fromkeys("RGB", DEPTH_M)
    OpenEXR.File(SCANLINES, gray).write(str(path))
    np.testing.assert_array_equal(read_stored_depth(path).displayed.values, DEPTH_M)
    OpenEXR.File(SCANLINES, {**gray, "G": DEPTH_M + 1}).write(str(path))
    with pytest.raises(InputError, match=r"a\.exr holds no depth; it has B, G, R"):
        read_stored_depth(path)


@pytest.mark.parametrize("colours", ["", "RGB"])
def test_normals_are_no_depth(colours: str, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    names = [*colours, "N.X", "N.Y", "N.Z"]
    OpenEXR.File(SCANLINES, {name: DEPTH_M + i for i, name in enumerate(names)}).write(str(path))
    with pytest.raises(
        InputError, match=rf"a\.exr holds no depth; it has {', '.join(sorted(names))}"
    ):
        read_stored_depth(path)


def test_exr_under_a_name_that_is_not_utf_8(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    folder.mkdir()
    path = folder / os.fsdecode(b"d\xe9pth.exr")
    ExrWriter().write(DepthMap(DEPTH_M, provenance=Provenance("m", "0" * 64, (1, 1))), path)
    assert [p.name for p in folder.iterdir()] == [path.name]
    np.testing.assert_array_equal(read_stored_depth(path).displayed.values, DEPTH_M)
    assert read_metadata(path)["model"] == "m"


def test_exr_on_a_full_disk_is_one_clear_error(tmp_path: Path) -> None:
    script = (
        "import resource, signal, sys; from pathlib import Path; import numpy as np\n"
        "from depthcli.core.types import DepthMap\n"
        "from depthcli.io.storage.atomic import atomic_path\n"
        "from depthcli.io.formats.exr import ExrWriter\n"
        "noise = np.random.default_rng(0).random((200, 200), np.float32)\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "with atomic_path(Path(sys.argv[1])) as path: ExrWriter().write(DepthMap(noise), path)\n"
    )
    words = [sys.executable, "-c", script, tmp_path / "a.exr"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=unmeasured())
    assert done.stderr.splitlines()[-1].endswith(
        f"{tmp_path}/a.exr: File too large; choose another out"
    )
    assert list(tmp_path.iterdir()) == []


def test_overflow_of_half_floats_is_a_warning(tmp_path: Path) -> None:
    depth = DepthMap(np.array([[1, 70_000, np.inf]], np.float32))
    with np.errstate(over="raise"):  # NumPy's own warning would be a second one
        warnings = ExrWriter(half=True).write(depth, tmp_path / "a.exr")
    assert warnings == ("1 pixels are beyond half floats and became infinite",)
    np.testing.assert_array_equal(
        read_stored_depth(tmp_path / "a.exr").displayed.values, [[1, np.inf, np.inf]]
    )


@pytest.mark.parametrize(
    "texts",
    [
        {"scale": "inf"},
        {"scale": "-3"},
        {"scale": "many"},
        {"scale": "1e-320"},
        {"scale": "1e300"},
        {"scale": "9" * 5000},
        {"scale": "normalized"},
        {"scale": "normalized", "range": "1"},
        {"scale": "normalized", "range": "nan 1"},
        {"scale": "normalized", "range": "near far"},
        {"scale": "normalized", "range": "5 1"},
        {"scale": "normalized", "range": "0 1e300"},
        {"kind": "unheard of"},
    ],
)
def test_texts_that_make_no_sense_leave_millimetres(texts: dict[str, str], tmp_path: Path) -> None:
    labels = {f"depthcli:{name}": text for name, text in texts.items()}
    data = encode_png(np.array([[1500, 0]], np.uint16), labels)
    (tmp_path / "a.png").write_bytes(data)
    depth = read_stored_depth(tmp_path / "a.png").displayed
    assert depth.kind is DepthKind.METRIC
    np.testing.assert_array_equal(depth.values, np.array([[1.5, np.nan]], np.float32))


def test_a_stated_scale_wins_over_normalization(tmp_path: Path) -> None:
    Png16Writer(png_normalize=True).write(DepthMap(DEPTH_M), tmp_path / "a.png")
    assert read_stored_depth(tmp_path / "a.png").displayed.values == pytest.approx(
        DEPTH_M, abs=1e-4
    )
    assert read_stored_depth(tmp_path / "a.png", png_scale=65535).displayed.values.max() == 1


@pytest.mark.parametrize(
    ("shape", "found"),
    [((1, 1, 5), (1, 5)), ((5, 1, 1), (5, 1)), ((1, 3, 4), (3, 4)), ((1, 1), (1, 1))],
)
def test_npy_with_batch_or_channel_axes(
    shape: tuple[int, ...], found: tuple[int, int], tmp_path: Path
) -> None:
    np.save(tmp_path / "a.npy", np.ones(shape, np.float64))
    depth = read_stored_depth(str(tmp_path / "a.npy")).displayed
    assert (depth.values.shape, depth.values.dtype) == (found, np.float32)


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
    with pytest.raises(InputError, match=r"a\.npy (is|holds)"):
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
    problem = f"{name} is missing: no such file" if content is None else name
    with pytest.raises(InputError, match=problem) as caught:
        read_stored_depth(tmp_path / name)
    assert "\n" not in str(caught.value)
    if name == "a.exr":
        with pytest.raises(InputError, match=name):
            read_metadata(tmp_path / name)


def test_pictures_and_other_suffixes_are_no_depth(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(made.png([b"\1\2"], 2, 8, 0))
    (tmp_path / "b.png").write_bytes(made.png([bytes(6)], 1, 16, 2))
    for name in ("a.png", "b.png"):
        with pytest.raises(InputError, match="16-bit gray"):
            read_stored_depth(tmp_path / name)
    with pytest.raises(InputError, match=r"is not a depth file \(\.png, "):
        read_stored_depth(tmp_path / "a.tiff")


@settings(max_examples=150, deadline=None)
@given(st.sampled_from([Format.PNG16, Format.EXR, Format.NPY]), st.data())
def test_damage_is_an_error_or_a_map(name: Format, draw: st.DataObject) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"a{FORMATS[name].suffix}"
        writer_class(name)().write(DepthMap(DEPTH_M), path)
        data = bytearray(path.read_bytes())
        for at in draw.draw(st.lists(st.integers(0, len(data) - 1), max_size=4)):
            data[at] = draw.draw(st.integers(0, 255))
        path.write_bytes(data[: draw.draw(st.integers(0, len(data)))])
        try:
            assert read_stored_depth(path).displayed.values.ndim == 2
            read_metadata(path)
        except InputError:
            return


STATED = Provenance("nyu", "ab" * 32, (192, 144), focal_px=518.75, orientation=6)


@pytest.mark.parametrize("name", [Format.PNG16, Format.EXR, Format.NPY])
def test_stated_facts_are_kept(name: Format, tmp_path: Path) -> None:
    path = tmp_path / f"a{FORMATS[name].suffix}"
    writer_class(name)().write(DepthMap(DEPTH_M, provenance=STATED), path)
    SidecarWriter().write(DepthMap(DEPTH_M, provenance=STATED), path.with_suffix(".json"))
    found = read_stored_depth(path).displayed
    assert found.kind is DepthKind.METRIC
    assert found.provenance is not None
    assert found.provenance.model == "nyu"
    assert found.provenance.model_sha256 == "ab" * 32
    assert found.provenance.focal_px == 518.75
    assert found.provenance.orientation == 6


@pytest.mark.parametrize("text", ["-400", "0", "nan", "inf", "", "wide"])
def test_a_focal_length_that_makes_no_sense_is_left_out(text: str, tmp_path: Path) -> None:
    steps = np.full((3, 4), 1500, np.uint16)
    texts = {"depthcli:focal_px": text, "depthcli:model": "nyu", "depthcli:orientation": "9"}
    (tmp_path / "a.png").write_bytes(encode_png(steps, texts))
    assert read_stored_depth(tmp_path / "a.png").displayed.provenance == Provenance("nyu")
