"""Tiles, and panoramas."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenEXR
import pytest
from helpers.tiny import load, point_cloud, write_model
from hypothesis import given, strategies as st
from PIL import Image

from depthcli.core.camera import Intrinsics
from depthcli.core.options import AUTO_TILE, Projection, Upsampling, UpsamplingOptions
from depthcli.core.types import DepthKind, DepthMap, Frame, Provenance, Transform, panorama_rays
from depthcli.errors import InputError
from depthcli.inference.pipeline import Pipeline, tile_width_px
from depthcli.inference.tiles import HFOV_DEG, TileGrid, _pixels_of, panorama_distance, refine
from depthcli.inference.transforms import coarse_depth, full_size, prepare
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.images.read import read_image
from depthcli.models.card import OutputSpec

METRIC = OutputSpec(DepthKind.METRIC, Transform.LINEAR, 1.0, 0.0, 0.5, 10.0)
RELATIVE = OutputSpec(DepthKind.RELATIVE, Transform.LINEAR, 1.0, 0.0, None, None)
COARSE = (24, 32)


def ramp(height: int = 300, width: int = 400) -> Frame:
    """A float image that is its own smooth depth: 1 m to 7 m, curved."""
    rows, columns = np.mgrid[0:height, 0:width]
    depth_m = 1 + 3 * (rows / height) ** 2 + 3 * np.sin(columns / width * 1.5)
    return Frame((depth_m / 10).astype(np.float32))


def seen(frame: Frame) -> np.ndarray:
    """The image's depth at the size of a network's output."""
    from depthcli.core.imageops import resize_area  # noqa: PLC0415 - beside what uses it

    return resize_area(frame.pixels.astype(np.float32) * 10, COARSE[1], COARSE[0])


def moody(frame: Frame) -> np.ndarray:
    """As networks are: each tile has a scale of its own, by what it shows, and bends."""
    depth_m = seen(frame)
    factor = np.float32(0.7 + 0.1 * depth_m.mean())
    bend = 1 + 0.1 * np.sin(np.linspace(0, np.pi, COARSE[1]))
    return np.clip(depth_m * factor * bend.astype(np.float32), 0.5, 10).astype(np.float32)


def test_tiles_cover_the_image_and_overlap() -> None:
    grid = TileGrid.plan(1000, 300, COARSE)
    assert (grid.width, grid.height) == (107, 80)
    covered = np.zeros((grid.height, grid.width), int)
    tiles = grid.tiles
    for rows, columns in tiles:
        assert (rows.stop - rows.start, columns.stop - columns.start) == COARSE
        covered[rows, columns] += 1
    assert covered.min() == 1
    assert covered[:, grid.width // 2].max() > 1
    assert len(tiles) == len({(r.start, c.start) for r, c in tiles})
    lefts = sorted({columns.start for _, columns in tiles})
    assert np.diff(lefts).max() <= 0.75 * COARSE[1]


@given(st.integers(1, 50), st.integers(1, 50), st.data())
def test_pixels_of_cells_are_theirs_and_at_least_one(
    size: int, cells: int, data: st.DataObject
) -> None:
    start = data.draw(st.integers(0, cells - 1))
    stop = data.draw(st.integers(start + 1, cells))
    found = _pixels_of(slice(start, stop), size, cells)
    assert 0 <= found.start < found.stop <= size
    assert abs(found.start - start * size / cells) <= 1
    assert -0.5 <= found.stop - stop * size / cells <= 1


@pytest.mark.parametrize("network", [seen, moody])
@pytest.mark.parametrize("tile_px", [90, 160, 250])
def test_no_seam_shows(network: Callable[[Frame], np.ndarray], tile_px: int) -> None:
    frame = ramp()
    joined = np.log(refine(METRIC, network(frame), frame, tile_px, network))
    grid = TileGrid.plan(frame.width, tile_px, COARSE)
    # A seam is a jump of slope: a second difference at a tile's border above those elsewhere.
    bends = np.abs(np.diff(joined, 2, axis=1)).max(axis=0)
    borders = {edge for _, columns in grid.tiles for edge in (columns.start, columns.stop)}
    at_border = [i for i in range(bends.size) if {i, i + 1, i + 2} & (borders - {0, grid.width})]
    elsewhere = np.setdiff1d(np.arange(bends.size), at_border)
    assert len(at_border) > 2
    assert bends[at_border].max() <= 1.2 * bends[elsewhere].max()
    assert np.abs(np.diff(joined, axis=1)).max() < 0.2


@pytest.mark.parametrize("kind", ["scale", "shift"])
def test_relative_tiles_are_fitted_by_scale_and_shift(kind: str) -> None:
    frame = ramp()

    def tile(part: Frame) -> np.ndarray:
        return 3 * seen(part) if kind == "scale" else seen(part) - 20

    joined = refine(RELATIVE, seen(frame), frame, 150, tile)
    fine = refine(RELATIVE, seen(frame), frame, 150, seen)
    np.testing.assert_allclose(joined, fine, atol=0.01)


def test_a_map_with_holes_is_left_as_it_is() -> None:
    overall = np.full(COARSE, np.nan, np.float32)
    assert refine(RELATIVE, overall, ramp(), 100, seen) is overall


@pytest.fixture
def camera(tmp_path: Path) -> Callable[[UpsamplingOptions], Pipeline]:
    """The tiny model, 16×12, with a choice of detail."""
    folder = write_model(tmp_path / "tiny")
    return lambda detail: load(folder, provider="cpu", detail=detail)


def textured(height: int = 96, width: int = 128) -> Frame:
    rng = np.random.default_rng(0)
    patches = rng.integers(0, 256, (height // 4, width // 4, 3), dtype=np.uint8)
    return Frame(patches.repeat(4, 0).repeat(4, 1))


def test_tiles_make_the_map_sharper(camera: Callable[[UpsamplingOptions], Pipeline]) -> None:
    frame = textured()
    truth = 1 + 8 / 255 * frame.pixels.max(axis=2)
    errors = [
        np.abs(
            camera(UpsamplingOptions(Upsampling.BILINEAR, tile)).predict(frame).depth.values - truth
        ).mean()
        for tile in (None, 32)
    ]
    assert errors[1] < 0.8 * errors[0]


def test_a_tiled_map_is_guided_as_far_as_a_pixel_of_the_whole_image_reaches(
    camera: Callable[[UpsamplingOptions], Pipeline],
) -> None:
    """Tiles of 32 of 128 columns: the joined map is four times as fine as the whole image's."""
    frame = textured()
    pipeline = camera(UpsamplingOptions(Upsampling.GUIDED, 32))
    spec = pipeline.card.output

    def predict(part: Frame) -> np.ndarray:
        batch, place = prepare(pipeline.card.input, part)
        return coarse_depth(spec, pipeline.session.run(batch)[0], place)

    joined = refine(spec, predict(frame), frame, 32, predict)
    expected, nearer = (
        full_size(spec, joined, frame, Upsampling.GUIDED, radius=radius) for radius in (4, 3)
    )
    found = pipeline.predict(frame).depth.values
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert np.abs(found - nearer).max() > 0.01


@pytest.mark.parametrize(
    ("tile", "width", "expected"),
    [
        (None, 1000, None),
        (AUTO_TILE, 1000, 750),
        (AUTO_TILE, 1001, 751),
        (AUTO_TILE, 20, 16),
        (AUTO_TILE, 16, None),
        (300, 1000, 300),
        (1000, 1000, None),
        (2000, 1000, None),
    ],
)
def test_width_of_tiles(
    camera: Callable[[UpsamplingOptions], Pipeline],
    tile: int | None,
    width: int,
    expected: int | None,
) -> None:
    frame = Frame(np.zeros((8, width), np.uint8))
    spec, options = camera(UpsamplingOptions()).card.input, UpsamplingOptions(tile_px=tile)
    assert tile_width_px(spec, frame, options) == expected


def test_tiles_have_no_less_detail_than_the_network(
    camera: Callable[[UpsamplingOptions], Pipeline],
) -> None:
    """16 × 12 pixels of the network, of which a pixel of the image has four at most."""
    spec, frame = camera(UpsamplingOptions()).card.input, Frame(np.zeros((300, 400), np.uint8))
    assert tile_width_px(spec, frame, UpsamplingOptions(tile_px=8)) == 8  # (192 / 4 · 4 / 3)^½
    for tile_px in (7, -1):
        with pytest.raises(InputError):
            tile_width_px(spec, frame, UpsamplingOptions(tile_px=tile_px))


@pytest.mark.parametrize("upsampling", list(Upsampling))
def test_memory_stays_within_what_was_counted(
    camera: Callable[[UpsamplingOptions], Pipeline], upsampling: Upsampling
) -> None:
    import tracemalloc  # noqa: PLC0415 - only here

    height, width = 3000, 4000
    frame = Frame(np.full((height, width, 3), 100, np.uint8))
    # Pixels are there already; depth and bands are what may come on top.
    limit = frame.pixels.nbytes + 4 * height * width + 8_000_000
    pipeline = camera(UpsamplingOptions(upsampling, AUTO_TILE))
    tracemalloc.start()
    depth = pipeline.predict(frame).depth
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak + frame.pixels.nbytes <= limit
    assert depth.values.shape == (height, width)


EQUIRECTANGULAR = Projection.EQUIRECTANGULAR
XMP = b'<x:xmpmeta><rdf:Description GPano:ProjectionType="equirectangular"/></x:xmpmeta>'


def _norms(side: int) -> npt.NDArray[np.float32]:
    along = np.tan(np.radians(HFOV_DEG) / 2) * ((np.arange(side) + 0.5) * 2 / side - 1)
    return np.sqrt(1 + along**2 + along[:, np.newaxis] ** 2).astype(np.float32)


VIEWS_DEG = [
    *((yaw, 0) for yaw in range(0, 360, 45)),
    *((yaw + 22.5, pitch) for pitch in (45, -45) for yaw in range(0, 360, 45)),
    *((0, pitch) for pitch in (90, -90)),
]


def _directions(side: int, yaw: float, pitch: float) -> npt.NDArray[np.float64]:
    """Unit vectors to the pixels of a view, which looks to the right by yaw and up by pitch."""
    ahead = np.array([np.sin(yaw) * np.cos(pitch), -np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    right = np.array([np.cos(yaw), 0, -np.sin(yaw)])
    down = np.array([np.sin(yaw) * np.sin(pitch), np.cos(pitch), np.cos(yaw) * np.sin(pitch)])
    along = np.tan(np.radians(HFOV_DEG) / 2) * ((np.arange(side) + 0.5) * 2 / side - 1)
    found = ahead + along[:, None] * right + along[:, None, None] * down
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def test_each_direction_has_its_distance_in_the_metres_of_level_views() -> None:
    """Colours of the panorama are its directions; views up and down are half as far again."""
    rays, slope, turns = panorama_rays(256, 128), np.array([1, 0.5, 0.25]), iter(VIEWS_DEG)

    def predict(view: Frame) -> npt.NDArray[np.float32]:
        yaw, pitch = np.radians(next(turns))
        directions = _directions(view.width, yaw, pitch)
        np.testing.assert_allclose(view.pixels * 2 - 1, directions, atol=0.02)
        metres = (3 + directions @ slope) / _norms(view.width) * (1.5 if pitch else 1)
        return metres.astype(np.float32)

    found = panorama_distance(Frame((rays + 1) / 2), predict)
    assert next(turns, None) is None
    np.testing.assert_allclose(found, 3 + rays @ slope, rtol=3e-3)


def test_views_that_differ_by_a_factor_are_joined_without_a_seam() -> None:
    random = np.random.default_rng(0)

    def predict(view: Frame) -> npt.NDArray[np.float32]:
        return np.float32(2 * random.uniform(0.8, 1.25)) / _norms(view.width)

    found = panorama_distance(Frame(np.zeros((64, 128), np.uint8)), predict)
    edges = np.abs(found[:, 0] / found[:, -1] - 1)
    assert np.median(edges) < 0.02
    assert found.max() / found.min() < 1.02


def test_panorama_that_does_not_show_all_directions_is_refused(tmp_path: Path) -> None:
    pipeline = load(write_model(tmp_path / "m", camera={"hfov_deg": 60.0}))
    whole, part = (
        Frame(np.full((32, width), 90, np.uint8), projection=EQUIRECTANGULAR) for width in (64, 50)
    )
    found = pipeline.predict(whole)
    assert found.depth.values.shape == (32, 64)
    assert found.depth.provenance.focal_px is None
    for frame, camera in ((part, Intrinsics()), (whole, Intrinsics(hfov_deg=60.0))):
        with pytest.raises(InputError):
            pipeline.predict(frame, camera)
    with pytest.raises(InputError):
        load(write_model(tmp_path / "n", camera=None)).predict(whole)


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
