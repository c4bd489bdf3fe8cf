"""Depth for programs that reconstruct a scene, read by their readers' own formulas."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import made
from helpers.command_line import Cli
from helpers.tiny import write_image
from PIL import Image

HEIGHT, WIDTH = 48, 64
UNITS_PER_M = 3.0
NAMES = {"a.png": 60, "hall/b.jpg": 120}
"""Images of a ramp, and the least of its gray levels."""


def ramp(low: int) -> np.ndarray[Any, Any]:
    row = np.linspace(low, low + 120, WIDTH)
    return np.repeat(np.rint(row).astype(np.uint8)[None, :, None], HEIGHT, 0).repeat(3, 2)


def true_depth(low: int) -> np.ndarray[Any, Any]:
    """Depth of a ramp in the scene's unit, of a network that has 1 m for black, 9 m for white."""
    return UNITS_PER_M * (1 + 8 * (ramp(low)[..., 0] / 255))


def assert_is_true(depth: Any, low: int) -> None:
    """Where upsampling from the network's 16 columns has neighbours on both sides."""
    np.testing.assert_allclose(depth[:, 4:-4], true_depth(low)[:, 4:-4], rtol=0.01)


@pytest.fixture
def scene(inside: Cli) -> Cli:
    """Images, and a reconstruction of points on their surfaces; cameras look along z."""
    points, lines = [], []
    for number, (name, low) in enumerate(NAMES.items(), 1):
        write_image(inside.folder / "images" / name, ramp(low))
        depth, views = true_depth(low), []
        for y, x in np.ndindex(5, 6):
            row, column = 4 + 9 * y, 4 + 10 * x
            z = depth[row, column]
            points.append(f"{len(points) + 1} {(column - 32) * z / 50} {(row - 24) * z / 50} {z}")
            views.append(f"{column + 0.5} {row + 0.5} {len(points)}")
        lines += [f"{number} 1 0 0 0 0 0 0 1 {name}", " ".join(views)]
    folder = inside.folder / "sparse/0"
    folder.mkdir(parents=True)
    (folder / "cameras.txt").write_text(f"1 PINHOLE {WIDTH} {HEIGHT} 50 50 32.5 24.5\n")
    (folder / "images.txt").write_text("\n".join(lines))
    (folder / "points3D.txt").write_text("".join(f"{point} 9 9 9 0.5\n" for point in points))
    return inside


BATCH = ("batch", "images", "--anchors", "sparse/0", "--anchors-fit", "global")


def gaussian_splatting_inverse_depth(depths: Path, params: Path, name: str) -> Any:
    """What scene/dataset_readers.py, utils/camera_utils.py and scene/cameras.py make of an image.

    Returns None for an image whose scale is so unlike the others' that its depth is not used.
    """
    table = json.loads(params.read_text())
    median = np.median([entry["scale"] for entry in table.values() if entry["scale"] > 0])
    stem = name[: -len(name.rsplit(".", 1)[1]) - 1]
    share = cv2.imread(str(depths / f"{stem}.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) / 2**16
    scale, offset = table[stem]["scale"], table[stem]["offset"]
    return share * scale + offset if 0.2 * median <= scale <= 5 * median else None


def test_gaussian_splatting_reads_the_true_inverse_depth(scene: Cli) -> None:
    scene(*BATCH, "-o", "depths", "--layout", "3dgs", "--sidecar", code=0)
    depths, first = scene.folder / "depths", {}
    for name, low in NAMES.items():
        inverse = gaussian_splatting_inverse_depth(depths, depths / "depth_params.json", name)
        assert_is_true(1 / inverse, low)
        first[name] = inverse
    (depths / "hall/b.png").unlink()  # only it is made again
    again = scene(*BATCH, "-o", "depths", "--layout", "3dgs", "--sidecar", "--json", code=0)
    is_kept = {row["input"]: row["kept"] for row in map(json.loads, again.stdout.splitlines())}
    assert is_kept == {"a.png": True, "hall/b.jpg": False}
    inverse = gaussian_splatting_inverse_depth(depths, depths / "depth_params.json", "hall/b.jpg")
    np.testing.assert_array_equal(inverse, first["hall/b.jpg"])


def test_colmap_reads_the_true_depth_in_its_depth_maps(scene: Cli) -> None:
    out = scene.folder / "dense/stereo/depth_maps"
    scene(*BATCH, "-o", out, "--layout", "colmap", code=0)
    for name, low in NAMES.items():
        width, height, channels, data = (out / f"{name}.geometric.bin").read_bytes().split(b"&", 3)
        assert (int(width), int(height), int(channels)) == (WIDTH, HEIGHT, 1)
        depth = np.frombuffer(data, "<f4").reshape(HEIGHT, WIDTH)
        assert_is_true(depth, low)


def write_transforms(cli: Cli, *names: str) -> None:
    frames = [{"file_path": f"images/{name}", "transform_matrix": []} for name in names]
    scene = {"fl_x": 50.0, "ply_file_path": "sparse.ply", "frames": frames}
    (cli.folder / "transforms.json").write_text(json.dumps(scene))


def test_nerfstudio_reads_the_true_depth_of_each_frame(scene: Cli) -> None:
    write_transforms(scene, *NAMES, "missing.png")
    scene(*BATCH, "-o", "depths", "--transforms", "transforms.json", code=0)
    folder = scene.folder / "depths"
    table = json.loads((folder / "transforms.json").read_text())
    assert table["fl_x"] == 50.0
    assert (folder / table["ply_file_path"]).resolve() == scene.folder / "sparse.ply"
    assert len(table["frames"]) == len(NAMES)  # it needs depth of all frames or of none
    for frame, (name, low) in zip(table["frames"], NAMES.items(), strict=True):
        assert (folder / frame["file_path"]).resolve() == scene.folder / "images" / name
        depth = cv2.imread(str(folder / frame["depth_file_path"]), cv2.IMREAD_ANYDEPTH)
        assert_is_true(depth.astype(np.float64) * 1e-3, low)


@pytest.mark.parametrize(
    "words",
    [
        (*BATCH, "--layout", "3dgs", "--format", "exr"),
        ("batch", "images", "--layout", "colmap"),
        (*BATCH, "--transforms", "transforms.json", "--layout", "3dgs"),
        (*BATCH, "--transforms", "transforms.json", "--png-inverse"),
        (*BATCH, "--transforms", "transforms.json", "--format", "npy"),
        (*BATCH, "--transforms", "transforms.json"),
        (*BATCH, "--transforms", "sparse/0/images.txt"),
    ],
)
def test_options_of_a_scene_that_do_not_fit_are_a_usage_error(
    scene: Cli, words: tuple[str, ...]
) -> None:
    (scene.folder / "transforms.json").write_text('{"frames": [{}]}')
    scene(*words, "-o", "depths", code=2)
    assert not list((scene.folder / "depths").glob("*.png"))


def test_the_tables_of_a_scene_replace_no_file_of_another_program(scene: Cli) -> None:
    write_transforms(scene, *NAMES)
    scene(*BATCH, "-o", ".", "--transforms", "transforms.json", code=1)
    assert "depth_file_path" not in (scene.folder / "transforms.json").read_text()
    (scene.folder / "depth_params.json").write_text("{}")
    scene(*BATCH, "-o", ".", "--layout", "3dgs", code=1)
    assert (scene.folder / "depth_params.json").read_text() == "{}"


def test_an_image_that_its_exif_turns_fails_for_a_scene(scene: Cli) -> None:
    pixels = np.rot90(ramp(60))
    Image.fromarray(pixels).save(scene.folder / "images/a.png", exif=made.exif(6))
    done = scene(*BATCH, "-o", "depths", "--layout", "3dgs", code=1)
    assert b"a.png" in done.stderr
    assert {*json.loads((scene.folder / "depths/depth_params.json").read_text())} == {"hall/b"}
