"""Stereo pairs: where each eye sees a pixel, and what fills the gaps."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from depthcli.core.options import StereoLayout
from depthcli.core.types import DepthKind, DepthMap, Frame, Provenance
from depthcli.errors import OutputError
from depthcli.io.formats.stereo import StereoWriter

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


def test_pixels_without_depth_are_far() -> None:
    depth = box_before_wall()
    depth.values[:5] = np.nan
    left, _ = eyes(depth, TEXTURE)
    np.testing.assert_array_equal(left[:5], eyes(box_before_wall(), TEXTURE)[0][:5])


def test_a_pair_needs_the_image(tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        StereoWriter().write(box_before_wall(), tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
