"""``depthcli view``, and the formats of three dimensions in the other commands."""

import re
import sys
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from av.sidedata.sidedata import Type
from helpers.command_line import Cli
from helpers.tiny import write_image
from helpers.videos import flat_frames, write_video

import depthcli
from depthcli.core.options import Eye, ReadOptions
from depthcli.core.types import DepthMap, Frame, Provenance
from depthcli.video.source import VideoSource


@pytest.fixture
def files(inside: Cli) -> Path:
    """A depth map of a floor, its image, and a map without metres."""
    depth_m = np.repeat(np.linspace(4, 2, 12, dtype=np.float32), 16).reshape(12, 16)
    np.save(inside.folder / "d.npy", depth_m)
    cv2.imwrite(str(inside.folder / "room.png"), np.full((12, 16, 3), 90, np.uint8))
    return inside.folder


def test_page_stands_beside_the_depth(inside: Cli, files: Path) -> None:
    assert not inside("view", "d.npy", "room.png", "--hfov", "60", code=0).stderr
    page = (files / "d.html").read_text("utf-8")
    assert "<title>room.png</title>" in page
    (files / "own.html").write_text("mine")
    assert inside("view", "d.npy", "-o", "own.html").returncode == 1
    assert (files / "own.html").read_text() == "mine"
    assert inside("view", "d.npy", "-o", "a.png").returncode == 2


def test_page_is_opened_in_the_browser(inside: Cli, files: Path) -> None:
    browser = files / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" >{files}/opened\n')
    browser.chmod(0o755)
    inside("view", "d.npy", "--open", "-q", BROWSER=f"{browser} %s", code=0)
    assert (files / "opened").read_text().strip() == (files / "d.html").as_uri()


def test_map_without_metres_makes_no_page(inside: Cli, files: Path) -> None:
    done = inside("view", "d.npy", "--from-kind", "relative", code=1)
    assert b"predict with --anchors" in done.stderr  # view itself has no such option
    assert not (files / "d.html").exists()


def test_each_format_is_written_by_predict_and_convert(inside: Cli, files: Path) -> None:
    formats = ("glb", "ply", "html", "normals", "stereo")
    options = [word for name in formats for word in ("--format", name)]
    write_image(files / "hall.png")
    assert inside("predict", "hall.png", *options, "--faces", "--stride", "2").returncode == 0
    names = ("glb", "ply", "html", "normals.png", "stereo.png")
    for name, suffix in zip(formats, names, strict=True):
        assert (files / f"hall.{suffix}").stat().st_size > 0
        image = ["--image", "room.png"] if name != "normals" else []
        done = inside("convert", "d.npy", f"e.{suffix}", "--hfov", "60", *image)
        assert (done.returncode, done.stderr) == (0, b"")
    assert inside("convert", "d.npy", "f.stereo.png").returncode == 1  # without the image
    # Outputs are no inputs of a batch.
    inside("batch", ".", "--out", "out", "--format", "normals", "--format", "glb", code=0)
    assert {path.name for path in (files / "out").iterdir()} >= {"hall.normals.png", "hall.glb"}
    assert not (files / "out" / "hall.stereo.normals.png").exists()


def test_usdz_without_its_package_names_the_extra(
    inside: Cli, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    monkeypatch.delitem(sys.modules, "depthcli.io.formats.usdz", raising=False)
    write_image(files / "hall.png")
    for words in (
        ("convert", "d.npy", "d.usdz", "--hfov", "60"),
        ("predict", "hall.png", "-o", "a.usdz"),
        ("batch", ".", "--out", "out", "--format", "usdz"),
    ):
        done = inside(*words, code=2)
        assert re.fullmatch(rb".*usd-core; pip install 'depthcli\[usd\]'\n", done.stderr), words
    assert not list(files.rglob("*.usdz"))


def test_video_is_a_stereo_video_and_numbered_normals(inside: Cli, files: Path) -> None:
    write_video(files / "clip.avi", flat_frames(range(3)))
    options = ("--format", "stereo", "--format", "normals", "--hfov", "60")
    inside("video", "clip.avi", *options, code=0)
    normals = [cv2.imread(str(path), -1) for path in sorted(files.glob("clip.normals.*.png"))]
    assert [normal.dtype for normal in normals] == [np.uint16] * 3


@pytest.mark.parametrize(
    ("layout", "packing", "times", "aspect"),
    [
        ("side-by-side", 1, (1, 2), 1),
        ("top-bottom", 2, (2, 1), 1),
        ("half-side-by-side", 1, (1, 1), 2),
        ("half-top-bottom", 2, (1, 1), 0.5),
    ],
)
def test_players_and_depthcli_know_the_layout_of_a_stereo_video(
    layout: str, packing: int, times: tuple[int, int], aspect: float, inside: Cli, files: Path
) -> None:
    """nagadomi/nunif#271, lossless1024/StreaMonitor#30: as mpv and VLC do."""
    frames = flat_frames(range(3))
    write_video(files / "clip.avi", frames)
    inside("video", "clip.avi", "-o", "x.stereo.mp4", "--stereo-layout", layout, code=0)
    with av.open(str(files / "x.stereo.mp4")) as video:
        coded = [*video.decode(video=0)]
    rows, columns = np.multiply(frames[0].shape[:2], times)
    assert [(frame.height, frame.width) for frame in coded] == [(rows, columns)] * 3
    assert bytes(coded[0].side_data.get(Type.STEREO3D))[:4] == bytes([packing, 0, 0, 0])
    left = next(VideoSource(files / "x.stereo.mp4", options=ReadOptions(eye=Eye.LEFT)).frames())
    assert left.width * left.pixel_aspect / left.height == frames[0].shape[1] / frames[0].shape[0]
    assert left.pixel_aspect == aspect


def test_notebooks_show_maps_and_pages(tmp_path: Path) -> None:
    values = np.repeat(np.linspace(4, 2, 12, dtype=np.float32), 16).reshape(12, 16)
    depth = depthcli.DepthMap.of(
        DepthMap(values, provenance=Provenance(focal_px=20.0)),
        Frame(np.zeros((12, 16, 3), np.uint8)),
    )
    image = cv2.imdecode(np.frombuffer(depth._repr_png_(), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(image[..., ::-1], depth.colorize())
    with pytest.warns(depthcli.DepthcliWarning):
        page = depthcli.DepthMap(values).view()
    assert page.html.startswith("<!doctype html>")
    assert page._repr_html_().count("<") == 2  # all of the page is within an attribute
    depth.save(tmp_path / "a.stereo.png", eye_distance_m=0.1, stereo_layout="anaglyph")
    assert cv2.imread(str(tmp_path / "a.stereo.png")).shape == (12, 16, 3)
    depth.save(tmp_path / "a.glb", stride=2)
    assert (tmp_path / "a.glb").read_bytes()[:4] == b"glTF"
