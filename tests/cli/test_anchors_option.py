"""``--anchors`` of ``predict`` and ``batch``: known depth from files."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import made
from helpers.command_line import Cli
from helpers.folders import printed, rows, tree
from helpers.tiny import synthetic_image, write_image, write_model


def sparse_twice(cli: Cli, name: str) -> np.ndarray:
    """Known depth for an image, twice what the model says at every fourth pixel, and 5 m nearer.

    Some points are of something far behind.
    """
    assert cli("predict", name, "-o", "plain.npy").returncode == 0
    known_m = np.load(cli.folder / "plain.npy") * 2 + 5
    sparse_m = np.zeros_like(known_m)
    sparse_m[::2, ::2] = known_m[::2, ::2]
    sparse_m[::8, ::8] = 90
    return sparse_m


def points(cli: Cli, *names: str) -> Path:
    """Tables of one point each, in the folder ``known``."""
    folder = cli.folder / "known"
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.csv").write_text("x,y,depth_m\n5,4,2\n")
    return folder


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_a_sparse_map_scales_an_image(inside: Cli, kind: str) -> None:
    write_image(inside.folder / "room.png", synthetic_image())
    write_model(inside.models / "one", output__kind=kind)
    assert inside("predict", "room.png", "--model", "one", "-o", "one.npy").returncode == 0
    plain = np.load(inside.folder / "one.npy")
    known_m = (2 * plain + 5) if kind != "inverse" else 1 / (2 * plain + 5)
    sparse_m = np.zeros_like(known_m)
    sparse_m[::2, ::2] = known_m[::2, ::2]
    sparse_m[::8, ::8] = 90
    np.save(inside.folder / "lidar.npy", sparse_m)
    words = ("--anchors", "lidar.npy", "--model", "one", "-o", "d.npy", "--overwrite")
    done = inside("predict", "room.png", *words, "--json", code=0)
    np.testing.assert_allclose(np.load(inside.folder / "d.npy"), known_m, rtol=1e-4)
    facts = json.loads(done.stdout)
    wrong, count = np.count_nonzero(sparse_m == 90), np.count_nonzero(sparse_m)
    assert facts["unit"] == "m"
    residual_m = facts["anchors"].pop("residual_m")
    assert residual_m == pytest.approx(0, abs=1e-3)
    assert facts["anchors"] == {"given": count, "used": count - wrong, "fit": "local"}
    done = inside("predict", "room.png", *words)
    assert f"depth fitted to {count - wrong} of {count} anchors, median error 0.000 m" in (
        done.stdout.decode()
    )


def test_two_points_are_taken_by_a_bundled_network(inside: Cli) -> None:
    """The commands give the same bytes, and say which network made them."""
    write_image(inside.folder / "in/a.png", synthetic_image())
    table = "x,y,depth_m\n5,4,2\n37,32,6\n"
    (inside.folder / "points.csv").write_text(table)
    (inside.folder / "known").mkdir()
    (inside.folder / "known/a.csv").write_text(table)
    words = ("--format", "npy", "--json", "--anchors")
    bundled = {"DEPTHCLI_MODELS": ""}
    (alone,) = printed(inside("predict", "in/a.png", "-o", "x/", *words, "points.csv", **bundled))
    assert (alone["model"], alone["anchors"]["fit"]) == ("prompted", "network")
    assert inside("batch", "in", "-o", "y", *words, "known", **bundled).returncode == 0
    (row,) = rows(inside, "y").values()
    assert (row["anchors"]["fit"], row["anchors"]["model"]) == ("network", "prompted")
    depth_m = (inside.folder / "x/a.depth.npy").read_bytes()
    assert (inside.folder / "y/a.depth.npy").read_bytes() == depth_m
    local = ("-o", "z/", "--anchors-fit", "local", *words)
    fitted = inside("predict", "in/a.png", *local, "points.csv", **bundled)
    assert printed(fitted)[0]["model"] == "default"
    (inside.folder / "few.csv").write_text(table[: table.rindex("37,")])
    few = inside("predict", "in/a.png", "-o", "w/", *words, "few.csv", **bundled)
    assert (printed(few)[0]["model"], printed(few)[0]["anchors"]["fit"]) == ("default", "global")


def test_points_of_a_table_are_those_of_the_option(inside: Cli) -> None:
    write_image(inside.folder / "room.png", synthetic_image())
    (inside.folder / "points.csv").write_text("x,y,depth_m\n5,40,2\n60,40,12\n")
    words = ("predict", "room.png", "--sidecar", "-o")
    assert inside(*words, "a.png", "--anchor", "5,40,2", "--anchor", "60,40,12").returncode == 0
    assert inside(*words, "b.png", "--anchors", "points.csv").returncode == 0
    for suffix in ("png", "json"):
        a, b = ((inside.folder / f"{name}.{suffix}").read_bytes() for name in "ab")
        assert a == b
    sidecar = json.loads((inside.folder / "a.json").read_text())
    assert sidecar["anchors"]["used"] == sidecar["anchors"]["given"] == 2
    inside("predict", "room.png", "--sidecar", "-o", "c.png")
    assert json.loads((inside.folder / "c.json").read_text())["anchors"] is None


def test_points_of_one_image_for_several_are_a_warning_that_names_batch(inside: Cli) -> None:
    for name in ("a.jpg", "b.jpg"):
        write_image(inside.folder / name)
    points(inside, "a")
    words = ("--format", "npy", "-o", "out/")
    for anchors in (("--anchors", "known/a.csv"), ("--anchor", "5,4,2")):
        assert inside("predict", "a.jpg", *anchors, *words, code=0).stderr == b""
        stderr = inside("predict", "a.jpg", "b.jpg", *anchors, *words, code=0).stderr
        assert (stderr.count(b"warning"), stderr.count(b"'depthcli batch'")) == (1, 1)
    refused = inside("predict", "a.jpg", "b.jpg", "--anchors", "known", *words, code=2)
    assert b"'depthcli batch'" in refused.stderr


def test_an_assumed_scale_is_a_warning(inside: Cli) -> None:
    """2 m at every fourth pixel, 256 units per metre, which the PNG does not state."""
    assumed = "kitti.png states no scale, so millimetres are assumed"
    assumed += "; --anchors-scale states another"
    steps = np.zeros((48, 64), np.uint16)
    steps[::2, ::2] = 512
    write_image(inside.folder / "room.png")
    write_image(inside.folder / "kitti.png", steps)
    words = ("predict", "room.png", "--anchors", "kitti.png", "-o", "d.npy", "--overwrite")
    (facts,) = printed(inside(*words, "--json"))
    assert facts["warnings"] == [assumed]
    assert facts["median"] == pytest.approx(0.512, rel=1e-3)
    assert inside(*words).stderr.decode() == f"depthcli: warning: room.png: {assumed}\n"
    (facts,) = printed(inside(*words, "--anchors-scale", "256", "--json"))
    assert (facts["warnings"], facts["median"]) == ([], pytest.approx(2, rel=1e-3))
    assert inside("convert", "d.npy", "stated.png", "--png-scale", "256").returncode == 0
    (facts,) = printed(
        inside("predict", "room.png", "--anchors", "stated.png", "-o", "a.npy", "--json")
    )
    assert facts["warnings"] == []


def test_a_batch_has_a_file_for_each_image(inside: Cli) -> None:
    tree(inside, "a.png", "hall/b.jpg", "c.png")
    folder = points(inside, "hall/b")
    np.save(folder / "a.npy", sparse_twice(inside, "in/a.png"))
    batch = ("batch", "in", "--out", "out", "--anchors", "known")
    done = inside(*batch, code=1)
    assert "c.png: " in done.stderr.decode()
    by_name = rows(inside, "out")
    assert {name: row["status"] for name, row in by_name.items()} == {
        "a.png": "ok", "c.png": "failed", "hall/b.jpg": "ok",
    }  # fmt: skip
    assert by_name["a.png"]["anchors"]["used"] < by_name["a.png"]["anchors"]["given"]
    assert by_name["hall/b.jpg"]["anchors"]["used"] == 1
    assert by_name["c.png"]["anchors"] is None


def test_known_depth_of_two_images_of_one_stem_is_used_for_none(inside: Cli) -> None:
    tree(inside, "a.png", "a.jpg", "b.png", "hall/a.png")
    (inside.folder / "in/b.mp4").write_bytes(b"film")  # is fitted to nothing
    place = points(inside, "a", "b", "hall/a")
    batch = ("batch", "in", "--out", "out", "--anchors", "known", "--exclude", "*.mp4")
    assert inside(*batch).returncode == 1
    table = rows(inside, "out")
    assert {name for name, row in table.items() if row["status"] == "ok"} == {"b.png", "hall/a.png"}
    assert "known/a.csv" in table["a.jpg"]["error"]
    assert "a.png.csv" in table["a.png"]["error"]
    (place / "a.csv").rename(place / "a.png.csv")
    assert inside(*batch).returncode == 1
    assert [name for name, row in rows(inside, "out").items() if row["error"]] == ["a.jpg"]
    (place / "a.png.csv").rename(place / "a.csv")
    alone = ("batch", "in", "--out", "alone", "--anchors", "known", "--include", "a.jpg")
    assert inside(*alone).returncode == 0


def test_changed_known_depth_is_done_again(inside: Cli) -> None:
    tree(inside, "a.png", "b.png")
    folder = points(inside, "a", "b")
    batch = ("batch", "in", "--out", "out", "--anchors", "known")

    def kept() -> list[bool]:
        facts = printed(inside(*batch, "--json", code=0))
        return [row["kept"] for row in sorted(facts, key=lambda row: str(row["input"]))]

    def would() -> list[str]:
        return [row["would"] for row in printed(inside(*batch, "--dry-run", "--json"))]

    assert (kept(), kept(), would()) == ([False, False], [True, True], ["keep", "keep"])
    (folder / "a.csv").write_text("x,y,depth_m\n5,4,3\n")
    assert would() == ["do", "keep"]
    assert (kept(), kept()) == ([False, True], [True, True])
    (folder / "a.csv").write_text("x,y,depth_m,note\n5,4,3.0,same\n")
    assert kept() == [True, True]
    (folder / "a.csv").unlink()
    assert would() == ["fail", "keep"]
    assert inside("batch", "in", "--out", "out").returncode == 0
    assert [row["anchors"] for row in rows(inside, "out").values()] == [None, None]


def test_a_batch_takes_a_folder_and_no_videos(inside: Cli) -> None:
    tree(inside, "a.png")
    (inside.folder / "in" / "clip.mp4").write_bytes(b"film")
    points(inside, "a")
    done = inside("batch", "in", "--out", "out", "--anchors", "known/a.csv", code=2)
    assert "--anchors" in done.stderr.decode()
    done = inside("batch", "in", "--out", "out", "--anchors", "known", code=1)
    assert "clip.mp4 " in done.stderr.decode()
    assert rows(inside, "out")["a.png"]["status"] == "ok"


@pytest.mark.parametrize(("name", "format_"), [("a.depth.png", "png16"), ("a.depth.npy", "npy")])
def test_a_batch_does_not_replace_known_depth(inside: Cli, name: str, format_: str) -> None:
    write_image(inside.folder / "in" / "a.jpg", synthetic_image())
    known_m = sparse_twice(inside, "in/a.jpg")
    np.save(inside.folder / "known.npy", known_m)
    (inside.folder / "known").mkdir()
    assert inside("convert", "known.npy", f"known/{name}").returncode == 0
    before = (inside.folder / "known" / name).read_bytes()
    words = ("in", "-o", "known", "--anchors", "known", "--format", format_)
    for extra in ((), ("--dry-run",)):
        done = inside("batch", *words, *extra, code=1)
        assert b"is its known depth; choose another --out" in done.stdout + done.stderr
    assert (inside.folder / "known" / name).read_bytes() == before


def test_own_depth_of_images_is_used_where_there_is_any(inside: Cli) -> None:
    tree(inside, "a.jpg", "b.jpg", "c.jpg")
    plain, facts = inside.folder / "in/a.jpg", {"Format": "RangeLinear", "Near": "1", "Far": "3"}
    shades = np.full((6, 8), 127, np.uint8)
    no_unit = made.jpeg_with_depth(plain.read_bytes(), shades, **facts)
    plain.with_name("c.jpg").write_bytes(no_unit)
    plain.write_bytes(made.jpeg_with_depth(plain.read_bytes(), shades, Units="m", **facts))
    words = ("--anchors", "self", "--json", "--format", "npy", "-o")
    printed_rows = printed(inside("predict", "in/a.jpg", "in/b.jpg", "in/c.jpg", *words, "out/"))
    assert [row["anchors"] and row["anchors"]["given"] for row in printed_rows] == [48, None, None]
    assert [len(row["warnings"]) for row in printed_rows] == [1, 1, 1]  # whether it is metric
    assert printed_rows[0]["median"] == pytest.approx(1.996, abs=0.01)
    for kept in (False, True):
        assert [row["kept"] for row in printed(inside("batch", "in", *words, "all"))] == [kept] * 3
    assert rows(inside, "all")["a.jpg"]["anchors"]["given"] == 48
    assert inside("predict", "in/a.jpg", "--anchors-scale", "2", *words, "c/").returncode == 2


def test_fit_of_the_option_is_used_and_is_for_known_depth(inside: Cli) -> None:
    write_image(inside.folder / "in/a.png")
    np.save(inside.folder / "in/a.npy", sparse := sparse_twice(inside, "in/a.png"))
    sparse[:, 32:] *= 1.2
    np.save(inside.folder / "lidar.npy", sparse)
    plain = np.load(inside.folder / "plain.npy")
    words, maps = ("predict", "in/a.png", "--format", "npy", "--anchors", "lidar.npy"), []
    for fit in ("global", "local"):
        assert inside(*words, "--anchors-fit", fit, "-o", f"{fit}.npy").returncode == 0
        maps.append(np.load(inside.folder / f"{fit}.npy"))
    affine = np.polynomial.Polynomial.fit(plain.ravel(), maps[0].ravel(), 1)(plain)
    np.testing.assert_allclose(maps[0], affine, rtol=1e-4)
    assert np.abs(maps[1] / affine - 1).max() > 0.05
    plain_model = ("--anchors-fit", "network", "--model", "default", "-o", "n.npy")
    assert inside(*words, *plain_model).returncode == 1
    assert inside("predict", "in/a.png", "--anchors-fit", "local", "-o", "x/").returncode == 2
    batch = ("batch", "in", "-o", "out", "--anchors", "in", "--format", "npy")
    fits = [printed(inside(*batch, "--anchors-fit", fit, "--json")) for fit in ("local", "global")]
    assert [row["kept"] for (row,) in fits] == [False, False]


def test_clouds_and_reconstructions_are_known_depth(inside: Cli) -> None:
    """A point on the axis, 3 m before the camera, and one behind it."""
    pytest.importorskip("trimesh")
    for name in "ab":
        write_image(inside.folder / f"in/{name}.png")
    header = "ply\nformat ascii 1.0\nelement vertex 2\n"
    body = "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n-3 0 0\n3 0 0\n"
    (inside.folder / "cloud.ply").write_text(header + body)
    (inside.folder / "pose.txt").write_text("0 1 0 0\n0 0 1 0\n1 0 0 0\n")
    words = ("predict", "in/a.png", "--points", "cloud.ply", "--extrinsics", "pose.txt", "-o", "x/")
    words += ("--format", "npy", "--json")
    (facts,) = printed(inside(*words, "--focal-px", "50", "--centre-px", "31.5,23.5"))
    residual_m = pytest.approx(0, abs=1e-6)
    assert facts["anchors"] == {"used": 1, "given": 1, "residual_m": residual_m, "fit": "global"}
    assert np.load(inside.folder / "x/a.depth.npy")[24, 32] == pytest.approx(3)
    assert "1 of 2" in facts["warnings"][0]
    assert inside(*words).returncode == 2
    sparse = inside.folder / "sparse"
    sparse.mkdir()
    (sparse / "cameras.txt").write_text("1 PINHOLE 64 48 50 50 32 24\n")
    (sparse / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n32.5 24.5 7\n")
    (sparse / "points3D.txt").write_text("7 0 0 3 9 9 9 0.5\n")
    (facts,) = printed(
        inside("predict", "in/a.png", "--anchors", "sparse", "-o", "y/", *words[-3:])
    )
    assert facts["anchors"]["used"] == 1
    assert inside("batch", "in", "--anchors", "sparse", "-o", "out").returncode == 1
    assert {name: row["status"] for name, row in rows(inside, "out").items()} == {
        "a.png": "ok", "b.png": "failed",
    }  # fmt: skip
