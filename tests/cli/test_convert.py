"""The command convert: files, folders, videos."""

import json
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.folders import contents, printed
from helpers.made import exif, jpeg_with_exif
from helpers.stores import Bucket
from helpers.tiny import write_image

from depthcli.core.types import DepthMap, Provenance
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.raster import FloatWriter, Png16Writer, SidecarWriter
from depthcli.io.formats.table import Format
from depthcli.io.listing import NameFilter
from depthcli.jobs.convert import ConvertRequest, ConvertResult, convert_folder, plan_folder

DEPTH = DepthMap(np.full((6, 8), 2, np.float32), provenance=Provenance("m", "0" * 64, (4, 3), 16.0))


def points_m(path: Path) -> np.ndarray:
    """The points of a cloud, (N, 3) float32."""
    body = path.read_bytes().partition(b"end_header\n")[2]
    return np.frombuffer(body, [("xyz_m", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])[
        "xyz_m"
    ]


@pytest.fixture
def files(inside: Cli) -> Path:
    """One map, which states a focal length of 16 pixels, in every format that is read."""
    Png16Writer().write(DEPTH, inside.folder / "d.png")
    ExrWriter().write(DEPTH, inside.folder / "e.exr")
    FloatWriter().write(DEPTH, inside.folder / "n.npy")
    SidecarWriter().write(DEPTH, inside.folder / "n.json")
    FloatWriter().write(DEPTH, inside.folder / "bare.npy")
    return inside.folder


@pytest.mark.parametrize("name", ["d.png", "e.exr", "n.npy"])
def test_a_cloud_has_the_camera_that_its_input_states(inside: Cli, files: Path, name: str) -> None:
    assert not inside("convert", name, "a.ply", code=0).stderr
    assert np.ptp(points_m(files / "a.ply")[:, 0]) == pytest.approx(7 / 16 * 2, rel=1e-5)


def test_depth_without_a_camera_has_that_of_its_image(inside: Cli, files: Path) -> None:
    """As the NPY of any program beside a phone's photograph, or a panorama."""
    jpeg = cv2.imencode(".jpg", np.full((6, 8, 3), 90, np.uint8))[1].tobytes()
    (files / "room.jpg").write_bytes(jpeg_with_exif(jpeg, exif(focal_35mm=26)))

    def converted(*options: str) -> np.ndarray:
        command = ("convert", "bare.npy", "a.ply", "--image", "room.jpg", *options)
        assert not inside(*command, code=0).stderr
        return points_m(files / "a.ply")

    assert np.ptp(converted()[:, 0]) == pytest.approx(2 * 7 / (26 / 43.27 * 10), rel=1e-3)
    assert np.ptp(converted("--focal-px", "7")[:, 0]) == pytest.approx(2)
    radius_m = np.linalg.norm(converted("--projection", "equirectangular"), axis=1)
    np.testing.assert_allclose(radius_m, 2, rtol=1e-6)


def test_an_image_gives_the_points_their_colours(inside: Cli, files: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
    write_image(files / "room.png", pixels)
    assert inside("convert", "d.png", "a.ply", "--image", "room.png").returncode == 0
    body = (files / "a.ply").read_bytes().partition(b"end_header\n")[2]
    colours = np.frombuffer(body, np.uint8).reshape(-1, 27)[:, 24:]
    np.testing.assert_array_equal(colours, pixels.reshape(-1, 3))
    write_image(files / "other.png", pixels[:5])
    assert inside("convert", "d.png", "b.ply", "--image", "other.png").returncode == 1
    assert inside("convert", "d.png", "room.png", "--image", "room.png").returncode == 1


def test_a_preview_of_stored_depth_is_that_of_predict(inside: Cli) -> None:
    write_image(inside.folder / "room.png")
    options = ("--vmin", "0.5", "--vmax", "6", "--near", "white", "--legend", "--side-by-side")
    assert inside("predict", "room.png", "-o", "d.npy").returncode == 0
    assert inside("predict", "room.png", "-o", "p.preview.png", *options).returncode == 0
    command = ("convert", "d.npy", "c.preview.png", *options)
    assert inside(*command, "--image", "room.png").returncode == 0
    predicted, converted = ((inside.folder / f"{one}.preview.png").read_bytes() for one in "pc")
    assert converted == predicted
    assert inside(*command).returncode == 2


@pytest.mark.parametrize("target", ["b.png", "b.exr"])
def test_a_conversion_keeps_model_and_focal_length(inside: Cli, files: Path, target: str) -> None:
    assert inside("convert", "n.npy", target).returncode == 0
    made_by = read_stored_depth(files / target).displayed.provenance
    assert (made_by.model, made_by.model_sha256, made_by.focal_px) == ("m", "0" * 64, 16.0)
    assert inside("convert", "d.png", "b.json", "--png-scale", "256").returncode == 0
    facts = json.loads((files / "b.json").read_text())
    assert (facts["focal_px"], facts["model"], facts["png16_scale"]) == (16.0, "m", 256)


CALIBRATION = """image_width: 16
image_height: 12
camera_matrix: {rows: 3, cols: 3, data: [40, 0, 6.5, 0, 40, 4.5, 0, 0, 1]}
distortion_model: equidistant
distortion_coefficients: {rows: 1, cols: 4, data: [0.1, 0, 0, 0]}
projection_matrix: {rows: 3, cols: 4, data: [32, 0, 7.5, 0, 0, 32, 5.5, 0, 0, 0, 1, 0]}
"""
CAMERAS = [
    (("--focal-px", "40"), 40, None),
    (("--hfov", "90", "--centre-px", "3,2"), 4, (3, 2)),
    (("--calibration", "camera.yaml"), 20, (3, 2)),
    (("--calibration", "camera.yaml", "--rectified"), 16, (3.5, 2.5)),
]


@pytest.mark.parametrize(("options", "focal_px", "centre_px"), CAMERAS)
def test_outputs_have_the_given_camera(
    inside: Cli,
    files: Path,
    options: tuple[str, ...],
    focal_px: float,
    centre_px: tuple[float, float] | None,
) -> None:
    (files / "camera.yaml").write_text(CALIBRATION)
    inside("convert", ".", "--out", "clouds", "--format", "ply", *options, code=0)
    x, y = centre_px or (3.5, 2.5)
    for name in ("d", "bare"):
        first_m = points_m(files / "clouds" / f"{name}.ply")[0]
        assert first_m == pytest.approx([-x * 2 / focal_px, -y * 2 / focal_px, 2], rel=1e-5)
    for name in ("b.png", "b.exr", "b.json"):
        inside("convert", "bare.npy", name, *options, code=0)
        if name == "b.json":
            facts = json.loads((files / name).read_text())
            facts["centre_px"] = facts["centre_px"] and tuple(facts["centre_px"])
        else:
            depth = read_stored_depth(files / name).displayed
            facts = asdict(depth.provenance)
            np.testing.assert_array_equal(depth.values, DEPTH.values)
        assert facts["focal_px"] == pytest.approx(focal_px)
        assert (facts["centre_px"], facts["camera_source"]) == (centre_px, "option")


def test_a_calibration_warns_and_is_not_replaced(inside: Cli, files: Path) -> None:
    (files / "camera.yaml").write_text(CALIBRATION)
    command = ("convert", "d.png", "b.exr", "--calibration", "camera.yaml")
    assert inside(*command).stderr.startswith(b"depthcli: warning: ")
    assert not inside(*command, "--rectified").stderr + inside(*command, "--quiet").stderr
    (files / "camera.json").write_text(CALIBRATION)
    inside("convert", "d.png", "camera.json", "--calibration", "camera.json", code=1)
    assert (files / "camera.json").read_text() == CALIBRATION
    ExrWriter().write(DepthMap(np.ones((6, 12), np.float32)), files / "wide.exr")
    assert inside("convert", "wide.exr", "b.ply", *command[-2:]).returncode == 1


def test_the_sidecar_of_a_png_states_its_scale(inside: Cli) -> None:
    steps = np.full((6, 8), 2560, np.uint16)
    steps[0] = 0  # no depth
    cv2.imwrite(str(inside.folder / "kitti.png"), steps)
    assert inside("convert", "kitti.png", "kitti.json", "--from-scale", "256").returncode == 0
    assert json.loads((inside.folder / "kitti.json").read_text())["png16_scale"] == 256
    assert np.nanmax(read_stored_depth(inside.folder / "kitti.png").displayed.values) == 10
    for name in ("normalize", "inverse"):
        writer = Png16Writer(**{f"png_{name}": True}, vmin=1, vmax=4)
        writer.write(DEPTH, inside.folder / f"{name}.png")
        assert inside("convert", f"{name}.png", name, "--format", "json").returncode == 0
        (sidecar,) = inside.folder.glob(f"{name}*.json")
        facts = json.loads(sidecar.read_text())
        assert [facts[key] for key in ("png16_scale", "png16_min", "png16_max")] == [None, 1, 4]


@pytest.mark.parametrize("between", ["a.exr", "a.png", "a.npy"])
def test_a_cloud_has_the_shape_of_pixels_that_are_not_square(inside: Cli, between: str) -> None:
    source = Provenance(focal_px=5.0, pixel_aspect=2.0)
    wide = DepthMap(np.full((6, 8), 2, np.float32), provenance=source)
    ExrWriter().write(wide, inside.folder / "wide.exr")
    assert inside("convert", "wide.exr", between).returncode == 0
    if between == "a.npy":
        assert inside("convert", "wide.exr", "a.json").returncode == 0
    assert not inside("convert", between, "wide.ply", code=0).stderr
    xyz_m = points_m(inside.folder / "wide.ply")
    np.testing.assert_allclose(xyz_m.max(0), [3.5 / 5 * 2, 2.5 / 10 * 2, 2], rtol=1e-6)


TO_EXR = ("convert", "in", "--out", "out", "--format", "exr")


def depth_file(path: Path, depth_m: float = 2.0) -> Path:
    """A depth file of one depth, as PNG or NPY by its suffix."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = FloatWriter() if path.suffix == ".npy" else Png16Writer()
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
    plan = plan_folder(ConvertRequest(f"{folder}/in", f"{folder}/out", wanted))
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
    write_image(tree.folder / "in/0.png")
    (tree.folder / "in/hall/b.npy").write_bytes(b"")
    (tree.folder / "in/loop").symlink_to(".")
    (tree.folder / "in/velodyne.bin").write_bytes(b"points")
    np.save(tree.folder / "in/z.npy", np.ones((6, 8), np.uint16))
    done = tree(*TO_EXR, code=1)
    lines = done.stderr.decode().splitlines()
    assert [line.split(": ")[2].split()[0] for line in lines] == [
        *("loop", "in/0.png", "in/z.npy", "in/hall/b.npy")
    ]
    assert done.stdout.startswith(b"3 of 6 files converted, 3 failed, 4 files skipped")
    assert len(contents(tree, "out")) == 3
    facts = {line["input"]: line for line in printed(tree(*TO_EXR, "--json"))}
    assert [name for name, line in facts.items() if line["status"] == "failed"] == [
        *("in/0.png", "in/z.npy", "in/hall/b.npy")
    ]
    assert facts["in/b.png"] == {
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
    targets = names(tmp_path)
    assert len({name.casefold() for name in targets.values()}) == len(given)
    assert targets["a.depth.png"] == "a.depth.png.depth.exr"
    assert targets["a.npy"] == "a.npy.depth.exr"
    assert targets["c.npy"] == "c.depth.exr"
    assert targets["c.npy.exr"] == "c.npy.exr.depth.exr"
    assert targets["d.png"] != "d.depth.exr" != targets["D.png"]


@pytest.mark.parametrize(
    ("wanted", "suffix"), [(Format.EXR, "exr"), (Format.PLY, "ply"), (Format.PNG16, "png")]
)
def test_numbered_files_stay_numbered(tmp_path: Path, wanted: Format, suffix: str) -> None:
    depth_file(tmp_path / "in/clip.depth.000001.npy")
    assert names(tmp_path, wanted) == {"clip.depth.000001.npy": f"clip.depth.000001.{suffix}"}


def test_patterns_choose_and_change_no_name(tree: Cli) -> None:
    depth_file(tree.folder / "in/b.npy")
    tree(*TO_EXR, "--include", "*.png", "--exclude", "a.*", code=0)
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
    filter_ = NameFilter.of((), ("none",))
    request = ConvertRequest(bucket.uri("in"), bucket.uri("out"), Format.PNG16)
    plan = plan_folder(request, filter_)
    assert [file.name for file in plan.inputs] == ["z.npy", "hall/a.npy"]
    results = list(convert_folder(request, plan))
    assert all(isinstance(result, ConvertResult) for result in results)
    keys = {key for key in bucket.names() if key.startswith("out/")}
    assert keys == {"out/z.depth.png", "out/hall/a.depth.png"}
    assert [file.reason for file in plan.skipped] == [".txt"]
