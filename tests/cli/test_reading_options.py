"""Options that read images: white level, and layers of EXR."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from helpers.command_line import Cli
from helpers.tiny import write_image

RNG = np.random.default_rng(0)
SENSOR = RNG.integers(0, 4096, (48, 64, 3), dtype=np.uint16)
"""Of 12 bits, without a plateau at white."""


@pytest.fixture
def folder(inside: Cli) -> Path:
    """Two images of 12 bits in ``low``, and the same ones over the whole range in ``full``."""
    for number, pixels in enumerate((SENSOR, SENSOR[::-1])):
        for name, stored in (("low", pixels), ("full", np.rint(pixels * (65535 / 4095)))):
            write_image(inside.folder / name / f"f{number}.png", stored.astype(np.uint16))
    return inside.folder


def depths(folder: Path) -> list[np.ndarray]:
    return [np.load(path) for path in sorted(folder.glob("*.npy"))]


@pytest.mark.parametrize("command", ["predict", "batch", "video"])
def test_depth_is_that_of_the_whole_range(command: str, folder: Path, inside: Cli) -> None:
    for name, options in (("low", ("--white-level", "4095")), ("full", ())):
        images = [f"{name}/f0.png", f"{name}/f1.png"] if command == "predict" else [name]
        extra = ("--fps", "25") if command == "video" else ()
        words = (*images, "--out", f"out-{name}/", "--format", "npy", *options, *extra)
        assert not inside(command, *words, code=0).stderr
    low, full = depths(folder / "out-low"), depths(folder / "out-full")
    assert len(low) == len(full) == 2
    np.testing.assert_array_equal(low, full)
    assert np.median(low[0]) > 4  # of 1 to 9 m; dark images are near for the tiny model


def test_images_that_end_at_a_sensor_s_white_name_the_option(folder: Path, inside: Cli) -> None:
    pixels = np.minimum(SENSOR, 1023)
    for number in range(2):
        write_image(folder / "low" / f"f{number}.png", pixels)
    advice = "give --white-level 1023"
    done = inside("predict", "low/f0.png", "-o", "a.exr")
    assert done.stderr.decode().count(advice) == 1
    done = inside("video", "low/f%d.png", "--out", "b.mkv", "--fps", "25")
    assert done.stderr.decode().count(advice) == 1
    assert b"low/f0.png: " in done.stderr
    assert inside("batch", "low", "--out", "c").returncode == 0
    rows = [json.loads(line) for line in (folder / "c" / "manifest.jsonl").read_text().splitlines()]
    assert all("1023" in row["warnings"][0] for row in rows)
    assert inside("predict", "low/f0.png", "-o", "a.exr", "--white-level", "1023").stderr == b""
    done = inside("predict", "low/f0.png", "-o", "a.exr", "--white-level", "1000")
    assert b"has pixels up to 1023, above the white level of 1000" in done.stderr


LIGHT = np.random.default_rng(0).uniform(0, 1, (48, 64)).astype(np.float32)
DARK = LIGHT / 8


@pytest.fixture
def plates(inside: Cli) -> Path:
    """Plates of a bright and a dark layer, in ``layers``; the bright one alone, in ``alone``."""
    for number in range(2):
        for name, layers in (("layers", {"": DARK, "fg.beauty.": LIGHT}), ("alone", {"": LIGHT})):
            channels = {
                prefix + colour: (light * np.float32(1 - number / 4)).copy()
                for prefix, light in layers.items()
                for colour in "RGB"
            }
            (inside.folder / name).mkdir(exist_ok=True)
            header = {"type": OpenEXR.scanlineimage}
            OpenEXR.File(header, channels).write(str(inside.folder / name / f"p.{number}.exr"))
    (inside.folder / "list.txt").write_text("p.0.exr\np.1.exr\n")
    return inside.folder


def exr_depths(inside: Cli, command: str, name: str, *options: str) -> np.ndarray:
    """The depth of both plates of a folder."""
    out = f"out-{name}-{len(options)}"
    words = {
        "predict": (f"{name}/p.0.exr", f"{name}/p.1.exr", "-o", f"{out}/"),
        "batch": (name, "--files", "list.txt", "--out", out),
        "video": (name, "--out", f"{out}/", "--fps", "24"),
    }[command]
    assert not inside(command, *words, "--format", "npy", *options, code=0).stderr
    return np.array([np.load(path) for path in sorted((inside.folder / out).rglob("*.npy"))])


@pytest.mark.parametrize("command", ["predict", "batch", "video"])
@pytest.mark.parametrize("option", [("--exposure", "3"), ("--layer", "beauty")])
def test_depth_is_that_of_the_bright_image(
    command: str, option: tuple[str, str], plates: Path, inside: Cli
) -> None:
    assert plates.is_dir()
    expected = exr_depths(inside, command, "alone")
    assert len(expected) == 2
    assert np.abs(expected - exr_depths(inside, command, "layers")).max() > 0.1
    np.testing.assert_allclose(exr_depths(inside, command, "layers", *option), expected, rtol=1e-5)


def test_a_layer_that_is_not_there_is_an_error(plates: Path, inside: Cli) -> None:
    done = inside("predict", "layers/p.0.exr", "--layer", "spec", code=1)
    assert b"layers/p.0.exr has no layer 'spec' with R, G and B, or Y; it has fg.beauty" in (
        done.stderr
    )
    assert sorted(path.name for path in (plates / "layers").iterdir()) == ["p.0.exr", "p.1.exr"]
