"""Tiles, and panoramas."""

import math
from itertools import product
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from helpers.tiny import load, point_cloud, write_model
from PIL import Image

from depthcli.core.camera import Intrinsics
from depthcli.core.imageops import resize_area, resize_bilinear
from depthcli.core.options import AUTO_TILE, Projection, Upsampling, UpsamplingOptions
from depthcli.core.types import DepthKind, DepthMap, Frame, Provenance, Transform, panorama_rays
from depthcli.errors import InputError
from depthcli.inference.pipeline import Pipeline, tile_width_px
from depthcli.inference.session import Session
from depthcli.inference.tiles import TileGrid, _pixels_of, panorama_distance, refine
from depthcli.inference.transforms import coarse_depth, full_size, prepare
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.images.read import read_image
from depthcli.models.card import Colour, Fit, InputSpec, OutputSpec

METRIC = OutputSpec(DepthKind.METRIC, Transform.LINEAR, 1.0, 0.0, 0.5, 10.0)
RELATIVE = OutputSpec(DepthKind.RELATIVE, Transform.LINEAR, 1.0, 0.0, None, None)
COARSE = (24, 32)


def moody(frame: Frame) -> np.ndarray:
    """As networks are: each tile has a scale of its own, by what it shows, and bends."""
    depth_m = resize_area(frame.pixels, COARSE[1], COARSE[0]) * 10
    bend = 1 + 0.1 * np.sin(np.linspace(0, np.pi, COARSE[1], dtype=np.float32))
    return np.clip(depth_m * (0.7 + 0.1 * depth_m.mean()) * bend, 0.5, 10)


def gaussian(size: int) -> np.ndarray:
    """A blur of one cell's deviation, to four of them, of cells mirrored at both ends, (N, N)."""
    kernel = np.exp(-(np.arange(-4, 5) ** 2) / 2)
    cells = np.pad(np.eye(size), ((4, 4), (0, 0)), mode="symmetric")
    return np.stack([kernel / kernel.sum() @ cells[i : i + 9] for i in range(size)])


@pytest.mark.parametrize(("dtype", "most", "white"), [("u1", 255, 255), ("f4", 1.2, 1)])
def test_tiles_are_fitted_and_blended_as_loops_over_their_cells_have_it(
    dtype: str, most: float, white: int
) -> None:
    """Of 10 × 7 cells, at a quarter of an overlap; a tile that contradicts the whole is flat."""
    random = np.random.default_rng(0)
    frame = Frame((random.random((61, 91)) * most).astype(dtype))
    overall = random.random((7, 10), np.float32)
    whole = resize_bilinear(overall, 26, 18)
    total, weight, parts = np.zeros((18, 26)), np.zeros((18, 26)), []
    maps = [random.random((7, 10), np.float32) for _ in range(12)]
    maps[5], maps[6], maps[7] = maps[5] * np.nan, np.ones_like(overall), -whole[7:14, 8:18]
    for tile, (top, left) in zip(maps, product((0, 4, 7, 11), (0, 8, 16)), strict=True):
        edges = [round(row * 61 / 18) for row in (top, top + 7)]
        edges += [round(column * 91 / 26) for column in (left, left + 10)]
        parts.append(frame.pixels[slice(*edges[:2]), slice(*edges[2:])].clip(0, white))
        coarse = whole[top : top + 7, left : left + 10].astype(float)
        x, y = (resize_area(each - each.mean(), 4, 3) for each in (tile.astype(float), coarse))
        prior = 0.01 * tile.var()
        scale = max(0, (x * y).mean() + prior) / ((x * x).mean() + prior or 1)
        fitted = scale * tile + gaussian(7) @ (coarse - scale * tile) @ gaussian(10).T
        for row, column in np.ndindex(7, 10):
            share = np.sin(np.pi * (row + 0.5) / 7) ** 2 * np.sin(np.pi * (column + 0.5) / 10) ** 2
            used = coarse if np.isnan(tile).any() else fitted
            total[top + row, left + column] += (share + 1e-6) * used[row, column]
            weight[top + row, left + column] += share + 1e-6

    def predict(part: Frame) -> np.ndarray:
        np.testing.assert_array_equal(part.pixels, parts.pop(0))
        return maps[-1 - len(parts)]

    joined = refine(RELATIVE, overall, frame, 35, predict)
    np.testing.assert_allclose(joined, total / weight, atol=1e-6)


def test_cells_finer_than_pixels_have_the_pixel_that_they_are_in() -> None:
    pixels = [_pixels_of(slice(cell, cell + 1), 3, 7) for cell in range(7)]
    assert pixels == [slice(pixel, pixel + 1) for pixel in (0, 0, 1, 1, 2, 2, 2)]


@pytest.mark.parametrize("tile_px", [90, 160, 250])
def test_no_seam_shows_where_depth_is_smooth(tile_px: int) -> None:
    rows, columns = np.mgrid[:1:300j, :1:400j]
    frame = Frame((0.1 + 0.3 * rows**2 + 0.3 * np.sin(1.5 * columns)).astype(np.float32))
    joined = np.log(refine(METRIC, moody(frame), frame, tile_px, moody))
    grid = TileGrid.plan(frame.width, tile_px, COARSE)
    # A seam is a jump of slope: a second difference at a tile's border above those elsewhere.
    bends = np.abs(np.diff(joined, 2, axis=1)).max(axis=0)
    borders = {edge for _, columns in grid.tiles for edge in (columns.start, columns.stop)}
    at_border = [i for i in range(bends.size) if {i, i + 1, i + 2} & (borders - {0, grid.width})]
    elsewhere = np.setdiff1d(np.arange(bends.size), at_border)
    assert len(at_border) > 2
    assert bends[at_border].max() <= 1.2 * bends[elsewhere].max()
    assert np.abs(np.diff(joined, axis=1)).max() < 0.2


def test_a_map_with_holes_is_left_as_it_is() -> None:
    overall = np.full(COARSE, np.nan, np.float32)
    assert refine(RELATIVE, overall, Frame(np.zeros((9, 9), np.uint8)), 3, moody) is overall


@pytest.fixture
def tiny(tmp_path: Path) -> Session:
    """The tiny model, 16×12."""
    return load(write_model(tmp_path / "tiny"), provider="cpu").session


def test_a_tiled_map_is_guided_as_far_as_a_pixel_of_the_whole_image_reaches(tiny: Session) -> None:
    """Tiles of 32 of 128 columns: the joined map is four times as fine as the whole image's."""
    patches = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    frame = Frame(patches.repeat(4, 0).repeat(4, 1))
    pipeline = Pipeline(tiny, UpsamplingOptions(Upsampling.GUIDED, 32))
    spec = pipeline.card.output

    def predict(part: Frame) -> np.ndarray:
        batch, place = prepare(pipeline.card.input, part)
        return coarse_depth(spec, pipeline.session.run(batch)[0], place)

    joined = refine(spec, predict(frame), frame, 32, predict)
    expected, nearer = (
        full_size(spec, joined, frame, Upsampling.GUIDED, radius=radius) for radius in (4, 3)
    )
    tiled = pipeline.predict(frame).depth.values
    np.testing.assert_allclose(tiled, expected, rtol=1e-5)
    assert np.abs(tiled - nearer).max() > 0.01


@pytest.mark.parametrize(
    ("tile", "width", "height", "expected"),
    [
        (None, 1000, 8, None),
        (AUTO_TILE, 1000, 8, 750),
        (AUTO_TILE, 1001, 8, 751),
        (AUTO_TILE, 20, 8, 16),
        (AUTO_TILE, 16, 8, None),
        (300, 1000, 8, 300),
        (1000, 1000, 8, None),
        (2000, 1000, 8, None),
        (8, 400, 300, 8),  # (192 / 4 · 4 / 3)^½, so that a pixel has four of the network's at most
        (7, 400, 300, "give a tile of 8 or more"),
        (-1, 400, 300, "give a tile of 8 or more"),
    ],
)
def test_width_of_tiles(tile: int | None, width: int, height: int, expected: int | str) -> None:
    spec = InputSpec(Colour.VALUE, 16, 12, True, 1, Fit.STRETCH, (0.5,), (0.5,))
    frame, detail = Frame(np.zeros((height, width), np.uint8)), UpsamplingOptions(tile_px=tile)
    if isinstance(expected, str):
        with pytest.raises(InputError, match=expected):
            tile_width_px(spec, frame, detail)
    else:
        assert tile_width_px(spec, frame, detail) == expected


@pytest.mark.parametrize("upsampling", list(Upsampling))
def test_memory_stays_within_what_was_counted(tiny: Session, upsampling: Upsampling) -> None:
    import tracemalloc  # noqa: PLC0415 - only here

    height, width = 3000, 4000
    frame = Frame(np.full((height, width, 3), 100, np.uint8))
    # Pixels are there already; depth and bands are what may come on top.
    limit = frame.pixels.nbytes + 4 * height * width + 8_000_000
    pipeline = Pipeline(tiny, UpsamplingOptions(upsampling, AUTO_TILE))
    tracemalloc.start()
    depth = pipeline.predict(frame).depth
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak + frame.pixels.nbytes <= limit
    assert depth.values.shape == (height, width)


EQUIRECTANGULAR = Projection.EQUIRECTANGULAR
XMP = b'<x:xmpmeta><rdf:Description GPano:ProjectionType="equirectangular"/></x:xmpmeta>'
VIEWS_DEG = [
    *((yaw, 0) for yaw in range(0, 360, 45)),
    *((yaw + 22.5, pitch) for pitch in (45, -45) for yaw in range(0, 360, 45)),
    *((0, pitch) for pitch in (90, -90)),
]
HALF = math.tan(math.radians(65 / 2))  # of the width of a view at a depth of 1


def _turn(yaw_deg: float, pitch_deg: float) -> np.ndarray:
    """What is right, down and ahead in a view that looks to the right by yaw and up by pitch."""
    yaw, pitch = np.radians((yaw_deg, pitch_deg))
    right = np.cos(yaw), 0, -np.sin(yaw)
    down = np.sin(yaw) * np.sin(pitch), np.cos(pitch), np.cos(yaw) * np.sin(pitch)
    ahead = np.sin(yaw) * np.cos(pitch), -np.sin(pitch), np.cos(yaw) * np.cos(pitch)
    return np.array([right, down, ahead])


def _rays(side: int) -> np.ndarray:
    """Unit vectors to the pixels of a view, in that view."""
    along = ((np.arange(side) + 0.5) * 2 / side - 1) * HALF
    rays = np.stack([*np.meshgrid(along, along), np.ones((side, side))], axis=-1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("width", "side", "hole"), [(256, 52, None), (302, 61, None), (256, 52, 0)]
)
def test_each_direction_has_its_distance_in_the_metres_of_level_views(
    width: int, side: int, hole: int | None
) -> None:
    """Colours of the panorama are its directions; each view has a factor, one may have a hole."""
    rays, slope = panorama_rays(width, width // 4 * 2), (1, 0.5, 0.25)
    factors = np.exp(np.random.default_rng(0).normal(0, 0.3, 26))
    views = iter(enumerate(VIEWS_DEG))

    def predict(view: Frame) -> np.ndarray:
        (i, angles), local = next(views), _rays(side)
        directions = local @ _turn(*angles)
        atol = 0.02 if side % 2 else 3e-4  # a pole itself has the colours of its row
        np.testing.assert_allclose(view.pixels * 2 - 1, directions, atol=atol)
        metres = (3 + directions @ slope) * local[..., 2] * factors[i]
        metres[0, 0] *= np.nan if i == hole else 1
        return metres.astype(np.float32)

    distance = panorama_distance(Frame((rays + 1) / 2), predict)
    assert next(views, None) is None
    assert np.isnan(distance[width // 4, width // 2]) == (hole == 0)  # ahead, only the first looks
    counted = [factor for i, factor in enumerate(factors[:8]) if i != hole]
    expected = (3 + rays @ slope) * np.exp(np.log(counted).mean())
    np.testing.assert_allclose(distance, np.where(np.isnan(distance), np.nan, expected), rtol=1e-3)


def test_views_are_blended_in_log_with_weights_that_end_at_a_circle() -> None:
    """Each level view tells more to its right; near the horizon, no others are seen."""
    rays, views = panorama_rays(256, 128), iter(VIEWS_DEG)

    def predict(view: Frame) -> np.ndarray:
        local, (_, pitch_deg) = _rays(view.width), next(views)
        across = local[..., 0] / local[..., 2] / HALF
        return (np.exp(0 if pitch_deg else across) * local[..., 2]).astype(np.float32)

    distance = panorama_distance(Frame(np.zeros((128, 256), np.uint8)), predict)
    for row, column in product((57, 63, 70), range(256)):
        total = weights = 0
        for angles in VIEWS_DEG[:8]:
            x, y, z = _turn(*angles) @ rays[row, column]
            weight = max(0, 1 - (x**2 + y**2) / (z * HALF) ** 2) ** 2 if z > 0 else 0
            total, weights = total + weight * x / z / HALF, weights + weight
        assert distance[row, column] == pytest.approx(np.exp(total / weights), rel=2e-3)


@pytest.mark.parametrize(("width", "side"), [(16, 8), (302, 61), (5100, 1024)])
def test_views_have_the_pixels_of_the_panorama_within_bounds(width: int, side: int) -> None:
    def refuse(view: Frame) -> np.ndarray:
        raise InputError(f"a view of {view.width} pixels")

    with pytest.raises(InputError, match=f"a view of {side} pixels"):
        panorama_distance(Frame(np.zeros((width // 2, width), np.uint8)), refuse)


def gray(width: int) -> Frame:
    return Frame(np.full((32, width), 90, np.uint8), projection=EQUIRECTANGULAR)


def test_metres_of_a_panorama_are_those_of_the_camera_of_its_views(tmp_path: Path) -> None:
    pipeline = load(write_model(tmp_path, camera={"hfov_deg": 60.0}))
    depth, sha256 = pipeline.predict(gray(66)).depth, pipeline.session.model.sha256
    source = Provenance("tiny", sha256, (16, 12), None, 1, projection=EQUIRECTANGULAR)
    assert depth.provenance == source
    factor = math.sqrt(16 * 12) / 2 / HALF / (8 / math.tan(math.radians(30)))
    assert depth.values[15, 33] == pytest.approx((1 + 8 * 90 / 255) * factor, rel=6e-3)


def test_what_a_panorama_does_not_have_is_refused(tmp_path: Path) -> None:
    pipeline = load(write_model(tmp_path / "m", camera={"hfov_deg": 60.0}))
    pipeline.session.load_error = lambda: pipeline.session
    uncertain = Pipeline(pipeline.session, UpsamplingOptions(error=True))
    unscaled = load(write_model(tmp_path / "n", camera=None))
    for refusing, frame, camera, problem in (
        (pipeline, gray(67), Intrinsics(), "all directions is twice as wide as high, not 67×32"),
        (pipeline, gray(66), Intrinsics(hfov_deg=60.0), "no focal length"),
        (pipeline, gray(66), Intrinsics(centre_px=(33, 16)), "no principal point"),
        (uncertain, gray(66), Intrinsics(), "error of depth of a panorama is not known; leave"),
        (unscaled, gray(66), Intrinsics(), "no metres of a known camera"),
    ):
        with pytest.raises(InputError, match=problem):
            refusing.predict(frame, camera)
    with pytest.raises(InputError, match="no view"):
        panorama_distance(gray(66), lambda view: np.full((view.width,) * 2, np.nan, np.float32))


def test_point_cloud_of_a_panorama_is_along_its_rays(tmp_path: Path) -> None:
    source = Provenance(projection=EQUIRECTANGULAR)
    ExrWriter().write(
        DepthMap(np.full((8, 16), 2, np.float32), provenance=source), tmp_path / "a.exr"
    )
    depth = read_stored_depth(tmp_path / "a.exr").displayed
    xyz_m = point_cloud(depth, 1.0).xyz_m
    np.testing.assert_allclose(np.linalg.norm(xyz_m, axis=1), 2, rtol=1e-5)
    top, middle, right = xyz_m[8], xyz_m[3 * 16 + 8], xyz_m[4 * 16 + 12]
    assert (top[1], middle[2], right[0]) == pytest.approx((-2, 2, 2), abs=0.1)


@pytest.mark.parametrize("name", ["jpg", "exr"])
def test_panorama_that_is_read_as_a_pinhole_image_is_a_warning(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"a.{name}"
    pixels = np.full((32, 64, 3), 90, np.uint8)
    if name == "exr":
        header = {"envmap": OpenEXR.ENVMAP_LATLONG}
        OpenEXR.File(header, {"RGB": (pixels / 255).astype(np.float16)}).write(str(path))
    else:
        Image.fromarray(pixels).save(path, xmp=XMP)
    assert ["panorama" in text for text in read_image(path).warnings] == [True]
    for projection in ("pinhole", "equirectangular"):  # as they are written in Python
        frame = read_image(path, projection=projection)
        assert isinstance(frame.projection, Projection)
        assert (frame.warnings, frame.projection) == ((), projection)


def test_panorama_that_was_cropped_is_refused(tmp_path: Path) -> None:
    of = (b"FullPanoWidthPixels", b"64"), (b"CroppedAreaImageWidthPixels", b"32")
    facts = b" ".join(b'GPano:%s="%s"' % pair for pair in of)
    xmp = XMP.replace(b"/>", b" " + facts + b"/>")
    Image.new("L", (32, 16)).save(tmp_path / "a.webp", xmp=xmp)
    assert read_image(tmp_path / "a.webp").warnings
    with pytest.raises(InputError, match=r"a\.webp"):
        read_image(tmp_path / "a.webp", projection=EQUIRECTANGULAR)
