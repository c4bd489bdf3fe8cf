"""``--exposure`` and ``--layer``: what a plate does not state."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from helpers.command_line import Cli

LIGHT = np.random.default_rng(0).uniform(0, 1, (48, 64)).astype(np.float32)
DARK = LIGHT / 8


@pytest.fixture
def folder(inside: Cli) -> Path:
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


def depths(inside: Cli, command: str, name: str, *options: str) -> np.ndarray:
    """The depth of both plates of a folder."""
    out = f"out-{name}-{len(options)}"
    words = {
        "predict": (f"{name}/p.0.exr", f"{name}/p.1.exr", "-o", f"{out}/"),
        "batch": (name, "--files", "list.txt", "--out", out),
        "video": (name, "--out", f"{out}/", "--fps", "24"),
    }[command]
    done = inside(command, *words, "--format", "npy", *options)
    assert (done.returncode, done.stderr) == (0, b"")
    return np.array([np.load(path) for path in sorted((inside.folder / out).rglob("*.npy"))])


@pytest.mark.parametrize("command", ["predict", "batch", "video"])
@pytest.mark.parametrize("option", [("--exposure", "3"), ("--layer", "beauty")])
def test_depth_is_that_of_the_bright_picture(
    command: str, option: tuple[str, str], folder: Path, inside: Cli
) -> None:
    assert folder.is_dir()
    wanted = depths(inside, command, "alone")
    assert len(wanted) == 2
    assert np.abs(wanted - depths(inside, command, "layers")).max() > 0.1
    np.testing.assert_allclose(depths(inside, command, "layers", *option), wanted, rtol=1e-5)


def test_a_layer_that_is_not_there_is_an_error(folder: Path, inside: Cli) -> None:
    done = inside("predict", "layers/p.0.exr", "--layer", "spec")
    assert done.returncode == 1
    assert b"layers/p.0.exr has no layer 'spec' with R, G and B, or Y; it has fg.beauty" in (
        done.stderr
    )
    assert sorted(path.name for path in (folder / "layers").iterdir()) == ["p.0.exr", "p.1.exr"]
