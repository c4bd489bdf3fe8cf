"""Previews: near is warm whatever the limits, every map has one, and the legend tells the truth."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from depthcli.core.options import Colormap, Near
from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import UsageError
from depthcli.io.formats.preview import (
    PreviewWriter,
    colour_table,
    nearness,
    tick_value,
    with_legend,
)

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


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("vmin", "vmax"),
    [(None, None), (2, 5), (0, 6), (8.9, None), (None, 1.5), (50, None), (None, 0.1)],
)
def test_nearer_is_never_colder(kind: DepthKind, vmin: float | None, vmax: float | None) -> None:
    image = render(RAMP_M[:1], kind, vmin=vmin, vmax=vmax, colormap="gray")[0, :, 0].astype(int)
    steps = np.diff(image)
    assert (steps >= 0).all() if kind is DepthKind.INVERSE else (steps <= 0).all()


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


@pytest.mark.parametrize("height", [1, 10, 30, 480, 3000])
def test_the_legend_is_a_bar_with_near_at_the_top(height: int) -> None:
    colours = colour_table(Colormap.GRAY)
    picture = np.zeros((height, 10, 3), np.uint8)
    image = with_legend(picture, colours, 1, 9, DepthKind.METRIC)
    assert (image[:, :10] == 0).all()
    size = min(max(height / 480, 0.9), 4)
    top = min(round(16 * size), height // 4)
    bar = image[top : height - top, 10 + round(20 * size), 0].astype(int)
    if len(bar) > 1:
        assert (bar[0], bar[-1]) == (255, 0)
        assert (np.diff(bar) <= 0).all()


def test_side_by_side_has_the_picture_at_the_left(tmp_path: Path) -> None:
    deep = np.random.default_rng(0).integers(0, 65536, (60, 80), np.uint16)
    writer = PreviewWriter(side_by_side=True)
    writer.write(DepthMap(RAMP_M), tmp_path / "a.png", Frame(deep))
    data = np.frombuffer((tmp_path / "a.png").read_bytes(), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    assert image is not None
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
