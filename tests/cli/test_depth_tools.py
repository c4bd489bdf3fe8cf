"""``depthcli info``, ``probe`` and ``convert``."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.made import exif, jpeg_with_exif
from helpers.tiny import write_image
from helpers.videos import write_depth_video

import depthcli
from depthcli.io.depth.read import read_stored_depth


@pytest.fixture
def depth_npy(inside: Cli) -> Path:
    """A map of 1 to 9 m with one pixel without depth."""
    values = np.linspace(1, 9, 12 * 16, dtype=np.float32).reshape(12, 16)
    values[0, 0] = np.nan
    path = inside.folder / "d.npy"
    np.save(path, values)
    return path


def test_info_states_unit_scale_and_range(inside: Cli) -> None:
    write_image(inside.folder / "room.png")
    inside("predict", "room.png", "-o", "d.png", "--png-scale", "5000")
    facts = json.loads(inside("info", "d.png", "--json").stdout)
    depth = read_stored_depth(inside.folder / "d.png").displayed.values
    assert (facts["kind"], facts["unit"]) == ("metric", "m")
    assert (facts["width"], facts["height"], facts["valid"]) == (64, 48, 64 * 48)
    assert facts["max"] == pytest.approx(depth.max())
    assert facts["metadata"]["scale"] == "5000"
    assert facts["metadata"]["model"] == "tiny"
    lines = dict(
        line.split(maxsplit=1) for line in inside("info", "d.png").stdout.decode().split("\n")[:-1]
    )
    assert (lines["unit"], lines["scale"]) == (
        "m",
        "5000 per metre (as the file or its sidecar states)",
    )
    cv2.imwrite(str(inside.folder / "other.png"), np.full((4, 4), 1000, np.uint16))
    assert b"scale   1000 per metre (assumed; " in inside("info", "other.png").stdout


@pytest.mark.parametrize("name", ["d.npy", "d.exr", "d.png"])
def test_info_includes_metadata_of_the_sidecar(inside: Cli, name: str) -> None:
    path = write_image(inside.folder / "held.jpg")
    path.write_bytes(jpeg_with_exif(path.read_bytes(), exif(6)))
    assert inside("predict", "held.jpg", "-o", name, "--sidecar").returncode == 0
    metadata = json.loads(inside("info", name, "--json").stdout)["metadata"]
    assert (metadata["orientation"], metadata["model"]) == ("6", "tiny")
    # A sidecar of another model's map says nothing of this one.
    sidecar = inside.folder / "d.json"
    sidecar.write_text(sidecar.read_text().replace(metadata["model_sha256"], "0" * 64))
    after = json.loads(inside("info", name, "--json").stdout)["metadata"]
    assert ("orientation" in after) == (name == "d.npy")


def test_info_of_huge_numbers_is_json(inside: Cli) -> None:
    np.save(inside.folder / "huge.npy", np.full((2, 2), 3e38, np.float32))
    done = inside("info", "huge.npy", "--from-kind", "relative", "--json")
    facts = json.loads(done.stdout, parse_constant=pytest.fail)
    assert facts["median"] == pytest.approx(3e38)


@pytest.mark.usefixtures("depth_npy")
def test_probe_gives_the_depth_of_pixels(inside: Cli) -> None:
    done = inside("probe", "d.npy", "15,11", "0,0")
    assert (done.returncode, done.stdout) == (0, b"15,11  9 m\n0,0  no depth\n")
    first, second = map(
        json.loads, inside("probe", "d.npy", "15,11", "0,0", "--json").stdout.splitlines()
    )
    nothing = {"point_m": None, "normal": None, "error": None}
    assert first == {"x": 15, "y": 11, "depth": 9, **nothing, "unit": "m"}
    assert second["depth"] is None


@pytest.mark.parametrize("aspect", [1, 2])
def test_probe_gives_point_normal_and_size_where_the_camera_is_known(
    aspect: float, inside: Cli
) -> None:
    focal_px, normal = 100.0, np.array([0.6, 0.0, -0.8])
    x, y = np.meshgrid(
        (np.arange(64) - 31.5) / focal_px, (np.arange(48) - 23.5) / focal_px / aspect
    )
    plane_m = -2.4 / (normal[0] * x + normal[1] * y + normal[2])
    plane = depthcli.DepthMap(
        plane_m.astype(np.float32),
        provenance=depthcli.Provenance(focal_px=focal_px, pixel_aspect=aspect),
    )
    plane.save(inside.folder / "plane.png")  # in steps of a millimetre
    done = inside("probe", "plane.png", "50,10", "20,10,40,30", "--json")
    pixel, box = map(json.loads, done.stdout.splitlines())
    expected_m = np.array([x[10, 50], y[10, 50], 1]) * plane_m[10, 50]
    assert pixel["point_m"] == pytest.approx(expected_m, abs=1e-3)
    assert pixel["normal"] == pytest.approx(normal, abs=0.01)
    assert box["size_m"] == pytest.approx(np.array([20, 20 / aspect]) * box["median"] / 100)
    assert not box["is_on_edge"]
    assert b"point 0." in inside("probe", "plane.png", "50,10").stdout


@pytest.mark.parametrize("width", [1, 5])
def test_probe_warns_of_a_box_on_an_edge(width: int, inside: Cli) -> None:
    ramp = np.interp(np.arange(64), [32, 32 + width], [1, 3])  # as networks smear an edge
    values = np.repeat(ramp[np.newaxis], 48, axis=0)
    np.save(inside.folder / "e.npy", values.astype(np.float32))
    done = inside("probe", "e.npy", "0,0,20,20", "20,0,50,20", "--focal-px", "60")
    assert done.stderr.count(b"holds a near and a far surface") == 1
    assert b"20,0,50,20" in done.stderr


def test_probe_sums_up_boxes_and_masks(inside: Cli, depth_npy: Path) -> None:
    values = np.load(depth_npy)
    mask = np.zeros((12, 16), np.uint8)
    mask[2:5, 3] = 255
    cv2.imwrite(str(inside.folder / "mask.png"), mask)
    done = inside("probe", "d.npy", "0,0,4,2", "mask.png", "0,0,1,1", "--json")
    box, masked, empty = map(json.loads, done.stdout.splitlines())
    assert (box["area"], box["pixels"], box["without_depth"]) == ("0,0,4,2", 8, 0.125)
    valid = values[:2, :4][~np.isnan(values[:2, :4])]
    shares = {"min": 0, "p05": 5, "p25": 25, "median": 50, "p75": 75, "p95": 95, "max": 100}
    for name, percent in shares.items():
        assert box[name] == pytest.approx(np.percentile(valid, percent))
        assert masked[name] == pytest.approx(np.percentile(values[2:5, 3], percent))
        assert empty[name] is None
    assert (masked["area"], masked["pixels"], empty["without_depth"]) == ("mask.png", 3, 1)
    text = inside("probe", "d.npy", "0,0,4,2", "0,0,1,1").stdout.decode().splitlines()
    assert "12.5% without depth" in text[0]
    assert text[1] == "0,0,1,1  no depth in 1 pixels"


@pytest.mark.usefixtures("depth_npy")
@pytest.mark.parametrize(
    "place",
    ["16,0", "0,12", "4,2,4,6", "0,0,17,2", "0,0,-1,2", "1,2,3", "black.png", "9x9.png"],
)
def test_probe_refuses_areas_that_are_not_in_the_map(place: str, inside: Cli) -> None:
    cv2.imwrite(str(inside.folder / "black.png"), np.zeros((12, 16), np.uint8))
    cv2.imwrite(str(inside.folder / "9x9.png"), np.ones((9, 9), np.uint8))
    assert inside("probe", "d.npy", place).returncode == 2


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("probe", "d.png", "1,1"), "--from-scale"),
        (("convert", "d.png", "d.depth.npy"), "--from-scale"),
    ],
)
def test_an_assumed_scale_is_a_warning(inside: Cli, words: tuple[str, ...], option: str) -> None:
    cv2.imwrite(str(inside.folder / "d.png"), np.full((4, 4), 512, np.uint16))
    warning = inside(*words).stderr.decode()
    assert all(fact in warning for fact in ("d.png", "millimetres", option))
    assert inside(*words, option, "1000").stderr == b""
    assert inside("info", "d.png").stderr == b""  # which prints the scale


def test_one_frame_of_a_depth_video_is_a_map(inside: Cli) -> None:
    maps = [np.full((4, 6), metres, np.float32) for metres in (1, 2, 3)]
    write_depth_video(inside.folder / "d.mkv", maps, scale=100)
    assert inside("probe", "d.mkv", "3,3", "--frame", "2").stdout == b"3,3  3 m\n"
    fifth = inside("probe", "d.mkv", "3,3", "--frame", "2", "--from-scale", "500")
    assert fifth.stdout == b"3,3  0.6 m\n"
    assert inside("convert", "d.mkv", "d.npy", "--frame", "1").returncode == 0
    assert (np.load(inside.folder / "d.npy") == 2).all()
