"""The page of a map: its data as the script reads them, and in a browser where there is one."""

import base64
import json
import re
import shutil
import subprocess
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from depthcli.core.surface import surface_of
from depthcli.core.types import DepthMap, Frame, Provenance
from depthcli.io.formats.html import HtmlWriter
from depthcli.io.formats.table import is_own

BROWSER = shutil.which("chromium")
SOURCE = Provenance(focal_px=30.0, centre_px=(20.0, 10.0))


def made(height: int = 24, width: int = 40) -> DepthMap:
    """A ramp from 0.5 m to 60 m with a hole, and an edge."""
    values = np.geomspace(0.5, 60, height * width, dtype=np.float32).reshape(height, width)
    values[4:8, 10:20] = 0.4
    values[2, 3] = np.nan
    return DepthMap(values, provenance=SOURCE)


def data_of(page: str) -> dict[str, Any]:
    found = re.search(r'id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found[1])
    return data


def grid_of(data: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Depth and links, as page.js computes them: rows are differences to the row above."""
    size = data["height"], data["width"]
    planes = np.frombuffer(zlib.decompress(base64.b64decode(data["grid"])), np.uint8)
    high, low, links = (plane.reshape(size) for plane in np.split(planes, 3))
    steps = np.zeros(size, np.uint16)
    for y in range(size[0]):
        for x in range(size[1]):
            above = int(steps[y - 1, x]) if y else 0
            steps[y, x] = (int(high[y, x]) * 256 + int(low[y, x]) + above) % 65536
    depth_m = data["nearest_m"] * np.exp((steps.astype(float) - 1) * data["log_step"])
    return np.where(steps > 0, depth_m, np.nan), links


@pytest.mark.parametrize("stride", [1, 3])
def test_page_holds_the_points_and_their_links(stride: int, tmp_path: Path) -> None:
    depth = made()
    HtmlWriter(stride=stride, keep_edges=True).write(depth, tmp_path / "a.html")
    assert is_own(tmp_path / "a.html")
    data = data_of((tmp_path / "a.html").read_text("utf-8"))
    surface = surface_of(depth, 30.0, stride=stride)
    depth_m, links = grid_of(data)
    np.testing.assert_allclose(depth_m, surface.depth_m, rtol=1e-4)
    np.testing.assert_array_equal(links[:, :-1] & 1, surface.right)
    np.testing.assert_array_equal(links[:-1] >> 1, surface.down)
    assert (data["focal_px"], data["centre_px"]) == ([30.0, 30.0], [20.0, 10.0])
    assert (data["stride"], data["size_px"]) == (stride, [40, 24])


def test_page_has_the_image_and_loads_nothing(tmp_path: Path) -> None:
    pixels = np.zeros((24, 40, 3), np.uint8)
    pixels[..., 1] = np.arange(40) * 6
    page, _ = HtmlWriter().render(made(), Frame(pixels, tmp_path / "<i>.jpg"))
    jpeg = np.frombuffer(base64.b64decode(data_of(page)["image"]), np.uint8)
    shown = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)[..., ::-1]
    assert abs(shown.astype(int) - pixels).max() < 12
    assert "<title>&lt;i&gt;.jpg</title>" in page
    assert "default-src 'none'" in page
    assert not re.search(r'(src|href)="', page)
    assert not re.search(r"@\w+@", page)


def test_large_map_is_thinned_and_a_usual_one_is_below_3_mb() -> None:
    y, x = np.mgrid[:480, :640].astype(np.float32)
    noise = np.random.default_rng(0).normal(0, 0.002, (480, 640)).astype(np.float32)
    usual = DepthMap(2 + x / 400 + y / 300 + noise, provenance=SOURCE)
    page, _ = HtmlWriter(keep_edges=True).render(usual)
    assert data_of(page)["stride"] == 1
    assert len(page) < 3_000_000
    large = DepthMap(cv2.resize(usual.values, (1920, 1440)), provenance=SOURCE)
    assert data_of(HtmlWriter(keep_edges=True).render(large)[0])["width"] == 640


@pytest.mark.skipif(BROWSER is None, reason="no chromium on this machine")
def test_browser_shows_every_point(tmp_path: Path) -> None:
    depth = made()
    HtmlWriter(keep_edges=True).write(depth, tmp_path / "a.html")
    quiet = ("--disable-background-networking", "--disable-component-update", "--disable-sync")
    done = subprocess.run(
        [
            *(str(BROWSER), "--headless", "--no-sandbox", "--no-first-run", *quiet),
            *("--enable-unsafe-swiftshader", "--virtual-time-budget=20000", "--dump-dom"),
            *(f"--user-data-dir={tmp_path / 'browser'}", (tmp_path / "a.html").as_uri()),
        ],
        capture_output=True,
        check=False,
        timeout=120,
        text=True,
    )
    assert f'data-points="{depth.valid.sum()}"' in done.stdout
