"""What is drawn of depth: previews, stereo pairs and pages."""

import base64
import json
import math
import re
import shutil
import subprocess
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image

from depthcli.core.options import Colormap, Near, StereoLayout
from depthcli.core.surface import surface_of
from depthcli.core.types import DepthKind, DepthMap, Frame, Provenance
from depthcli.errors import OutputError, UsageError
from depthcli.io.formats.preview import PreviewWriter, colour_table, nearness, tick_value
from depthcli.io.formats.views import HtmlWriter, StereoWriter
from depthcli.io.guard import is_own

RAMP_M = np.linspace(1, 9, 60 * 80, dtype=np.float32).reshape(60, 80)
INVALID = [96, 96, 96]
KINDS = list(DepthKind)


def render(values: np.ndarray, kind: DepthKind = DepthKind.METRIC, **options: Any) -> np.ndarray:
    return PreviewWriter(**options).render(DepthMap(values.astype(np.float32), kind))


@given(
    arrays(
        np.float32,
        array_shapes(min_dims=2, max_dims=2, max_side=8),
        elements=st.floats(width=32, allow_nan=True),
    ),
    st.sampled_from(KINDS),
    st.sampled_from(Colormap),
    st.booleans(),
)
def test_every_map_has_a_preview(
    values: np.ndarray, kind: DepthKind, colormap: Colormap, legend: bool
) -> None:
    image = render(values, kind, colormap=colormap, legend=legend)
    assert image.dtype == np.uint8
    assert image.shape[0] == values.shape[0]
    nothing = np.isnan(values) if kind is not DepthKind.METRIC else ~(values > 0)
    assert (image[:, : values.shape[1]][nothing] == INVALID).all()


def test_limits_the_wrong_way_round_are_refused() -> None:
    with pytest.raises(UsageError):
        PreviewWriter(vmin=5, vmax=2)
    for limits in ({"vmin": math.nan}, {"vmax": math.nan}):
        with pytest.raises(UsageError):
            PreviewWriter(**limits)


def test_percentiles_leave_outliers_out() -> None:
    values = RAMP_M.copy()
    values[0, 0], values[-1, -1] = 0.001, 1000
    assert (render(values)[20:40] == render(RAMP_M)[20:40]).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("near", "far"), [(1.5, 6.0), (0.0, 6.0)])
def test_the_legend_says_what_the_colours_mean(kind: DepthKind, near: float, far: float) -> None:
    if kind is DepthKind.INVERSE:
        near, far = far, near
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        depth = DepthMap(np.array([[tick_value(share, near, far, kind)]], np.float32), kind)
        if not (kind is DepthKind.METRIC and depth.values[0, 0] == 0):
            assert nearness(depth, near, far)[0, 0] == pytest.approx(share, abs=1e-5)


def test_side_by_side_has_the_image_at_the_left(tmp_path: Path) -> None:
    deep = np.random.default_rng(0).integers(0, 65536, (60, 80), np.uint16)
    writer = PreviewWriter(side_by_side=True)
    writer.write(DepthMap(RAMP_M), tmp_path / "a.png", Frame(deep))
    data = np.frombuffer((tmp_path / "a.png").read_bytes(), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    assert image.shape == (60, 160, 3)
    np.testing.assert_array_equal(image[:, :80], Frame(deep).pixels_8bit())
    np.testing.assert_array_equal(image[:, 80:, ::-1], writer.render(DepthMap(RAMP_M)))


@pytest.mark.parametrize("name", Colormap)
def test_colormaps_end_bright_or_red_and_turn_round(name: Colormap) -> None:
    colours = colour_table(name).astype(int)
    assert colours.shape == (256, 3)
    assert colours[-1, 0] > colours[0, 0] + 50
    np.testing.assert_array_equal(colour_table(name, Near.BLACK), colours[::-1])
    np.testing.assert_array_equal(colour_table(name, Near.WHITE), colours)
    assert np.abs(np.diff(colours, axis=0)).max() < 15


HEIGHT, WIDTH = 40, 80
SOURCE = Provenance(focal_px=100.0)
BOX = np.s_[10:30, 30:50]
TEXTURE = Frame(np.random.default_rng(0).integers(0, 200, (HEIGHT, WIDTH, 3), np.uint8))


def box_before_wall() -> DepthMap:
    depth_m = np.full((HEIGHT, WIDTH), 4, np.float32)
    depth_m[BOX] = 1
    return DepthMap(depth_m, provenance=SOURCE)


def eyes(depth: DepthMap, frame: Frame, **options: float) -> tuple[np.ndarray, np.ndarray]:
    left, right = np.hsplit(StereoWriter(**options).render(depth, frame), 2)
    return left, right


def test_disparity_follows_from_eye_distance_and_screen() -> None:
    """100 px × 0.08 m × (1/1 m - 1/2 m) is 4 px before the screen, and 2 px behind it at 4 m."""
    left, right = eyes(box_before_wall(), TEXTURE, eye_distance_m=0.08, convergence_m=2.0)
    np.testing.assert_array_equal(left[10:30, 32:52], TEXTURE.pixels[BOX])
    np.testing.assert_array_equal(right[10:30, 28:48], TEXTURE.pixels[BOX])
    np.testing.assert_array_equal(left[:10, :-1], TEXTURE.pixels[:10, 1:])
    np.testing.assert_array_equal(right[:10, 1:], TEXTURE.pixels[:10, :-1])


def test_gaps_are_filled_with_what_is_behind() -> None:
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    pixels[..., 2] = 200
    pixels[BOX] = 255, 0, 0
    left, right = eyes(box_before_wall(), Frame(pixels), eye_distance_m=0.16, convergence_m=1.0)
    for view in (left, right):
        is_box = view[..., 0] > 100
        assert is_box.sum() == 20 * 20
        np.testing.assert_array_equal(view[~is_box], np.broadcast_to((0, 0, 200), (2800, 3)))


def test_a_smeared_edge_is_not_drawn_out() -> None:
    depth_m = np.full((HEIGHT, WIDTH), 4, np.float32)
    depth_m[:, 39], depth_m[:, :39] = 2, 1
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    pixels[:, :39] = 255
    left, _ = eyes(DepthMap(depth_m, provenance=SOURCE), Frame(pixels), eye_distance_m=0.4)
    assert not ((left > 5) & (left < 250)).any()


@pytest.mark.parametrize("kind", [DepthKind.RELATIVE, DepthKind.INVERSE])
def test_map_without_metres_is_three_percent_deep(kind: DepthKind) -> None:
    values = box_before_wall().values
    depth = DepthMap(1 / values if kind is DepthKind.INVERSE else values, kind)
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    pixels[20, 10] = pixels[20, 40] = 255
    left, right = (view[20, :, 0].astype(float) for view in eyes(depth, Frame(pixels)))
    far, near = (
        [float((row * np.arange(WIDTH))[part].sum() / row[part].sum()) for row in (left, right)]
        for part in (np.s_[:25], np.s_[25:])
    )
    assert far[1] - far[0] == pytest.approx(0.03 * WIDTH, abs=0.1)  # behind the screen
    assert near == [40, 40]


def test_anaglyph_has_the_left_eye_in_red(tmp_path: Path) -> None:
    left, right = eyes(box_before_wall(), TEXTURE)
    StereoWriter(stereo_layout=StereoLayout.ANAGLYPH).write(
        box_before_wall(), tmp_path / "a.png", TEXTURE
    )
    anaglyph = np.asarray(Image.open(tmp_path / "a.png"))
    np.testing.assert_array_equal(anaglyph, np.dstack([left[..., 0], right[..., 1], right[..., 2]]))
    above = StereoWriter(stereo_layout=StereoLayout.TOP_BOTTOM).render(box_before_wall(), TEXTURE)
    np.testing.assert_array_equal(above, np.vstack([left, right]))


def test_pixels_without_depth_are_far_and_black_if_transparent() -> None:
    depth = box_before_wall()
    depth.values[:5] = np.nan
    left, _ = eyes(depth, TEXTURE)
    np.testing.assert_array_equal(left[:5], eyes(box_before_wall(), TEXTURE)[0][:5])
    cut_out = replace(TEXTURE, transparent=~depth.valid)  # a PNG with alpha
    sheet = PreviewWriter(side_by_side=True).render(depth, cut_out)[:, :WIDTH]
    for view in (eyes(depth, cut_out)[0], sheet):
        assert (view[:5].any(), view[5:].any()) == (False, True)


def test_a_pair_needs_the_image(tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        StereoWriter().write(box_before_wall(), tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


BROWSER = shutil.which("chromium")
OF_PAGE = Provenance(focal_px=30.0, centre_px=(20.0, 10.0))


def made(height: int = 24, width: int = 40) -> DepthMap:
    """A ramp from 0.5 m to 60 m with a hole, and an edge."""
    values = np.geomspace(0.5, 60, height * width, dtype=np.float32).reshape(height, width)
    values[4:8, 10:20] = 0.4
    values[2, 3] = np.nan
    return DepthMap(values, provenance=OF_PAGE)


def data_of(page: str) -> dict[str, Any]:
    match = re.search(r'id="data">(.*?)</script>', page, re.DOTALL)
    data: dict[str, Any] = json.loads(match[1])
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
    image = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)[..., ::-1]
    assert abs(image.astype(int) - pixels).max() < 12
    assert "<title>&lt;i&gt;.jpg</title>" in page
    assert "default-src 'none'" in page
    assert not re.search(r'(src|href)="', page)
    assert not re.search(r"@\w+@", page)


def test_large_map_is_thinned_and_a_usual_one_is_below_3_mb() -> None:
    y, x = np.mgrid[:480, :640].astype(np.float32)
    noise = np.random.default_rng(0).normal(0, 0.002, (480, 640)).astype(np.float32)
    usual = DepthMap(2 + x / 400 + y / 300 + noise, provenance=OF_PAGE)
    page, _ = HtmlWriter(keep_edges=True).render(usual)
    assert data_of(page)["stride"] == 1
    assert len(page) < 3_000_000
    large = DepthMap(cv2.resize(usual.values, (1920, 1440)), provenance=OF_PAGE)
    assert data_of(HtmlWriter(keep_edges=True).render(large)[0])["width"] == 640
    full, _ = HtmlWriter(keep_edges=True, stride=1).render(large)
    assert data_of(full)["width"] == 1920


def shown_by_browser(page: Path, awaited: str) -> str:
    """The page's elements once they have these characters, or the last ones without."""
    quiet = ("--disable-background-networking", "--disable-component-update", "--disable-sync")
    command = [
        *(str(BROWSER), "--headless", "--no-sandbox", "--no-first-run", *quiet),
        *("--enable-unsafe-swiftshader", "--virtual-time-budget=20000", "--dump-dom"),
        *(f"--user-data-dir={page.parent / 'browser'}", page.as_uri()),
    ]
    dom = ""
    for _ in range(3):  # on a busy machine, its virtual time can end before the page has run
        dom = subprocess.run(
            command, capture_output=True, check=False, timeout=120, text=True
        ).stdout
        if awaited in dom:
            break
    return dom


@pytest.mark.skipif(BROWSER is None, reason="no chromium on this machine")
def test_browser_shows_every_point(tmp_path: Path) -> None:
    depth = made()
    HtmlWriter(keep_edges=True).write(depth, tmp_path / "a.html")
    points = f'data-points="{depth.valid.sum()}"'
    assert points in shown_by_browser(tmp_path / "a.html", points)


PRESS_KEYS = """<script type="module">
while (!document.body.dataset.points) await new Promise((done) => setTimeout(done, 20));
const views = ["r", "ArrowLeft", "+", "-", "ArrowRight", "ArrowUp", "?"].map((key) => {
  dispatchEvent(new KeyboardEvent("keydown", { key }));
  return document.getElementById("view").toDataURL();
});
document.body.dataset.views = views.map((view) => views.indexOf(view)).join(" ");
</script>"""


@pytest.mark.skipif(BROWSER is None, reason="no chromium on this machine")
def test_keys_orbit_zoom_and_show_their_list(tmp_path: Path) -> None:
    page, _ = HtmlWriter(keep_edges=True).render(made())
    (tmp_path / "a.html").write_text(page.replace("</body>", f"{PRESS_KEYS}</body>"), "utf-8")
    dom = shown_by_browser(tmp_path / "a.html", "data-views")
    assert 'data-views="0 1 2 1 0 5 5"' in dom
    assert ('id="list"' in dom, "hidden" in dom.partition('id="list"')[2][:40]) == (True, False)
