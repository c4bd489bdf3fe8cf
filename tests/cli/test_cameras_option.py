"""``depthcli batch --cameras``: what is said, and the table that ``render rooms`` writes."""

import csv

import pytest
from helpers.command_line import Cli
from helpers.folders import printed, rows, tree
from helpers.tiny import write_model

from depthcli.io.depth.read import read_metadata


@pytest.fixture
def scene(inside: Cli) -> Cli:
    """A folder of two pictures, a table for one of them, and a model that learned a camera."""
    write_model(inside.models / "default", camera={"hfov_deg": 60.0})
    tree(inside, "a.png", "hall/b.png")
    (inside.folder / "cameras.csv").write_text("id,focal_px\nhall/b,40\nattic,50\n")
    return inside


def test_the_summary_of_what_does_not_match(scene: Cli) -> None:
    words = ("batch", "in", "--out", "out", "--cameras", "cameras.csv")
    for extra in ((), ("--dry-run",)):
        done = scene(*words, *extra)
        assert done.returncode == 0
        without, unused = done.stderr.decode().splitlines()[:2]
        assert without.startswith("depthcli: warning: cameras.csv has no camera for 1 of 2 ")
        assert unused == (
            "depthcli: warning: 1 of 2 rows of cameras.csv match no input, for example 'attic'"
        )
    assert rows(scene, "out")["hall/b.png"]["camera"].endswith("(given)")
    assert rows(scene, "out")["a.png"]["camera"].endswith("(assumed, from the model's card)")
    (scene.folder / "cameras.csv").write_text("id,focal_px\nhall/b,41\n")
    again = printed(scene(*words, "--json"))
    assert {row["input"]: row["kept"] for row in again} == {"a.png": True, "hall/b.png": False}


def test_the_table_precedes_the_camera_of_a_profile(scene: Cli) -> None:
    (scene.folder / "depthcli.toml").write_text("[lens]\nhfov = 80\n")
    words = ("batch", "in", "--out", "out", "--profile", "lens", "--cameras", "cameras.csv")
    assert scene(*words).returncode == 0
    cameras = [row["camera"] for row in rows(scene, "out").values()]
    assert cameras == ["hfov 60.0° (assumed, from the model's card)", "hfov 44.8° (given)"]


def test_rendered_rooms_have_their_own_cameras(scene: Cli) -> None:
    words = ("--out", "rooms", "--count", "2", "--size", "24x16", "--workers", "1")
    assert scene("render", "rooms", *words).returncode == 0
    done = scene("batch", "rooms/rgb", "--out", "out", "--cameras", "rooms/cameras.csv")
    assert (done.returncode, done.stderr) == (0, b"")
    with (scene.folder / "rooms/cameras.csv").open() as file:
        for row in csv.DictReader(file):
            stated = read_metadata(scene.folder / "out" / f"{row['id']}.depth.png")
            assert float(stated["focal_px"]) == pytest.approx(float(row["focal_px"]), rel=1e-5)
            assert stated["camera_source"] == "option"
