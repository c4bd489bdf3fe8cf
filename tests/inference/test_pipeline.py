"""The pipeline, and what networks tell besides depth: masks, scales, points."""

import math
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from helpers.tiny import (
    fixed_inside,
    known_depth_onnx,
    load,
    prompted_onnx,
    synthetic_image,
    tiny_onnx,
    write_model,
)
from onnx import TensorProto, helper, numpy_helper

from depthcli.core import imageops
from depthcli.core.camera import UNKNOWN_CAMERA, Anchor, CameraScale, CameraSource, Intrinsics
from depthcli.core.options import DepthFit, DepthMask, UpsamplingOptions
from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import DepthcliError, InputError, ModelError, UsageError
from depthcli.inference.pipeline import (
    Pipeline,
    Prediction,
    _range_warnings,
    check_network,
    depth_for_trial,
    try_session,
)
from depthcli.inference.point_map import depth_of_points
from depthcli.inference.session import Session
from depthcli.inference.transforms import follow_points
from depthcli.known.local_correction import log_correction
from depthcli.known.points import KnownDepth
from depthcli.models.catalog import find_model


def gray(value: int, height: int = 30, width: int = 40, **facts: float) -> Frame:
    return Frame(np.full((height, width), value, np.uint8), **facts)


@pytest.fixture
def kinect(tmp_path: Path) -> Pipeline:
    """A model that learned a camera of 60 degrees."""
    return load(write_model(tmp_path / "kinect", camera={"hfov_deg": 60.0}))


@pytest.mark.parametrize(("shift_m", "metres"), [(-0.2, 1.8), (0.3, 2.3), (-2.0, math.nan)])
def test_metres_are_corrected_as_measured(
    model_folder: Path, shift_m: float, metres: float
) -> None:
    pipeline = load(model_folder)
    scale = CameraScale("robot", "tiny", pipeline.session.model.sha256, 2.0, shift_m, None, 1, 1)
    depth = pipeline.predict(gray(0), Intrinsics(scale=scale)).depth  # of 1 m
    np.testing.assert_allclose(depth.values, metres, rtol=1e-5)
    assert depth.provenance.camera_scale == scale
    with pytest.raises(UsageError, match="'robot' was calibrated with another model, 'tiny'"):
        pipeline.predict(gray(51), Intrinsics(scale=replace(scale, model_sha256="0" * 64)))


@pytest.mark.parametrize("fit", ["stretch", "keep-aspect"])
@pytest.mark.parametrize("dynamic", [True, False])
def test_every_fit_puts_depth_where_the_image_is(tmp_path: Path, fit: str, dynamic: bool) -> None:
    folder = write_model(tmp_path, input__fit=fit, input__dynamic=dynamic)
    pixels = synthetic_image(60, 180)
    depth = load(folder).predict(Frame(pixels)).depth.values
    expected = 1 + 8 / 255 * pixels.max(axis=-1)
    assert np.abs(depth - expected)[:, 12:-12].max() < 0.4


def test_an_output_of_lower_stride_is_brought_to_size(tmp_path: Path) -> None:
    folder = write_model(tmp_path, tiny_onnx(stride=2))
    depth = load(folder).predict(gray(255)).depth
    assert depth.values.shape == (30, 40)
    np.testing.assert_allclose(depth.values, 9, rtol=1e-5)


def test_a_trial_refuses_a_model_without_depth(tmp_path: Path) -> None:
    proto = onnx.load_from_string(tiny_onnx())
    nothing = np.full((1, 1, 1, 1), np.nan, np.float32)
    proto.graph.initializer[0].CopyFrom(onnx.numpy_helper.from_array(nothing, "weight"))
    session = Session(find_model(write_model(tmp_path, proto.SerializeToString())))
    with pytest.raises(ModelError, match="no depth for an image, no finite number"):
        try_session(session)
    with pytest.raises(ModelError, match=r"no depth for a\.png"):
        Pipeline(session).predict(replace(gray(0), path=Path("a.png")))


NO_DEPTH = ModelError("no depth of a.png")


@pytest.mark.parametrize(
    ("error", "height", "is_raised"),
    [(NO_DEPTH, 12, False), (NO_DEPTH, 13, True), (InputError("a.png is empty"), 13, False)],
)
def test_only_an_error_of_a_network_that_never_works_is_raised_again(
    tmp_path: Path, error: DepthcliError, height: int, is_raised: bool
) -> None:
    """Of one that runs on inputs of one height only; its card states 12."""
    session = Session(find_model(write_model(tmp_path, fixed_inside(height))), provider="cpu")
    with pytest.raises(ModelError) if is_raised else nullcontext() as caught:
        check_network(error, session)
    assert not is_raised or caught.value is error


def test_each_image_has_its_own_camera_and_anchors(kinect: Pipeline) -> None:
    frames = [Frame(np.full((24, 32), value, np.uint8)) for value in (90, 120, 150)]
    cameras = (Intrinsics(40.0), UNKNOWN_CAMERA, Intrinsics(hfov_deg=50.0))
    anchors = (None, KnownDepth.of([Anchor(3, 4, 2.5)]), None)
    together = kinect.predict_many(frames, cameras, anchors)
    for prediction, *inputs in zip(together, frames, cameras, anchors, strict=True):
        alone = kinect.predict(*inputs).depth
        np.testing.assert_array_equal(prediction.depth.values, alone.values)
        assert prediction.depth.provenance == alone.provenance
    assert together[1].depth.values[4, 3] == 2.5


def test_an_image_that_fails_does_not_stop_the_others_of_its_batch(kinect: Pipeline) -> None:
    outside = KnownDepth.of([Anchor(900, 4, 2.5)])
    good, bad = kinect.predict_many([gray(90)] * 2, [UNKNOWN_CAMERA] * 2, [None, outside])
    assert isinstance(good, Prediction)
    assert isinstance(bad, InputError)
    with pytest.raises(InputError):
        kinect.predict(gray(90), anchors=outside)


def test_a_network_that_takes_one_image_gets_one_at_a_time(
    tmp_path: Path, kinect: Pipeline
) -> None:
    graph = onnx.load_from_string(tiny_onnx())
    graph.graph.input[0].type.tensor_type.shape.dim[0].dim_value = 1
    single = load(write_model(tmp_path, graph.SerializeToString()))
    assert (single.session.takes_one, kinect.session.takes_one) == (True, False)
    predictions = single.predict_many([gray(0), gray(255)], [UNKNOWN_CAMERA] * 2, [None] * 2)
    assert [each.depth.values[9, 9] for each in predictions] == pytest.approx([1, 9])


def test_the_error_of_depth_is_what_another_model_gives(kinect: Pipeline) -> None:
    surely = Pipeline(kinect.session, UpsamplingOptions(error=True))
    with pytest.raises(InputError, match="error of depth of model 'tiny' is not known; leave"):
        surely.predict(gray(51))
    kinect.session.load_error = lambda: kinect.session
    np.testing.assert_allclose(surely.predict(gray(51)).depth.error, np.full((30, 40), 2.6))
    assert kinect.predict(gray(51)).depth.error is None


@pytest.mark.parametrize(
    ("end_m", "columns", "word"),
    [
        (1.02, 4, "nearer"),
        (0.5, 4, "nearer"),
        (17.64, 4, "farther"),
        (17.7, 3, None),
        (1.03, 4, None),
        (17.6, 4, None),
    ],
)
def test_many_pixels_at_an_end_of_the_range_are_told(
    model_folder: Path, end_m: float, columns: int, word: str | None
) -> None:
    """From a tenth of them on, within 2 % of the least or the largest depth."""
    spec = load(model_folder).card.output  # 0.5 to 10 m
    spec = replace(spec, max_m=9.0)
    values = np.full((40, 40), 3, np.float32)
    values[:, :columns] = end_m
    values[:, 3 - columns % 4 : 3] = 3  # every fourth is counted
    warnings = _range_warnings(spec, DepthMap(values), scale=2.0)
    assert [word in text for text in warnings] == [True] * bool(word)
    assert all(text.startswith("10%") and "1 to 18 m" in text for text in warnings)
    for kind, other in ((DepthKind.RELATIVE, spec), (DepthKind.METRIC, replace(spec, min_m=None))):
        assert not _range_warnings(other, DepthMap(values, kind), scale=2.0)


@pytest.fixture
def prompted(tmp_path: Path) -> Pipeline:
    """A model that gives known depth where there is some, and 1 m (black) elsewhere."""
    output = {"transform": "exp", "scale": 2.0, "shift": 2.0, "min_m": 0.5, "max_m": 10.0}
    changes = {f"output__{name}": value for name, value in output.items()}
    return load(write_model(tmp_path / "prompted", prompted_onnx(), input__prompt=True, **changes))


@pytest.mark.parametrize("known_m", [40.0, 0.1])
def test_known_depth_is_an_input_of_a_model_that_takes_it(
    prompted: Pipeline, known_m: float
) -> None:
    """The relief of its map is then that of the points, beyond the range of the model alone."""
    points = KnownDepth(np.arange(0, 40, 8), np.arange(0, 30, 6), np.full(5, known_m))
    anchors = [None, replace(points, fit=DepthFit.LOCAL), points]
    predictions = prompted.predict_many([gray(0)] * 3, [UNKNOWN_CAMERA] * 3, anchors)
    reliefs = [np.ptp(np.log(prediction.depth.values)) for prediction in predictions]
    assert reliefs[0] == pytest.approx(0, abs=1e-4)
    assert reliefs[1] == pytest.approx(0, abs=1e-4)
    assert reliefs[2] > 0.2
    tiled = Pipeline(prompted.session, UpsamplingOptions(tile_px=20)).predict(gray(0)).depth
    np.testing.assert_allclose(tiled.values, 1, rtol=1e-4)
    with pytest.raises(InputError, match="outside"):
        prompted.predict(gray(0), anchors=replace(points, x=points.x + 900))


def test_from_two_points_on_another_network_takes_them(
    prompted: Pipeline, kinect: Pipeline
) -> None:
    kinect.session.load_known_depth = lambda: prompted.session
    alone, both = (kinect.session.identity(knows_depth=knows) for knows in (False, True))
    assert both == (*alone[:-1], prompted.session.identity(knows_depth=False)) != alone
    many = KnownDepth(np.arange(0, 50, 8), np.arange(0, 42, 6), np.full(7, 2.0))
    two, one = (replace(many, x=many.x[:n], y=many.y[:n], depth_m=many.depth_m[:n]) for n in (2, 1))
    anchors = [None, one, two, many, replace(many, fit=DepthFit.LOCAL)]
    sources = [
        prediction.depth.provenance
        for prediction in kinect.predict_many([gray(0, 48, 64)] * 5, [UNKNOWN_CAMERA] * 5, anchors)
    ]
    base, other = kinect.card.name, prompted.card.name
    assert [source.model for source in sources] == [base, base, other, other, base]
    fits = [source.anchor_fit and source.anchor_fit.fit for source in sources]
    assert fits == [None, "global", "network", "network", "local"]


def test_depth_of_a_network_follows_few_points_as_that_makes_it(prompted: Pipeline) -> None:
    """Farther away, it gives 1 m; from five points on, the map around them follows, too."""
    x, y = np.arange(5, 10), np.arange(5, 10)
    away_m = []
    for count in (4, 5):
        points = KnownDepth(x[:count], y[:count], np.full(count, 2.0))
        away_m.append(prompted.predict(gray(0, 48, 64), anchors=points).depth.values[30, 5])
    assert away_m[0] == pytest.approx(1, rel=0.01)
    assert away_m[1] > 1.02


@pytest.mark.parametrize("noise", [0.05, 1e-4])
def test_points_are_followed_up_to_some_median_deviations(prompted: Pipeline, noise: float) -> None:
    """Up to 6.95 of them, or half a percent; those outside of the image are not counted."""
    random, frame = np.random.default_rng(0), gray(0)
    coarse_m = random.uniform(1, 2, (6, 8)).astype(np.float32)
    x, y = random.integers(0, 40, 22), random.integers(0, 30, 22)
    places = (y + 0.5) / 30, (x + 0.5) / 40
    mapped = imageops.sample_bilinear(np.log(coarse_m), *places)
    off = np.where(np.arange(22) % 2, noise, -noise)
    off[-2:] = -max(6 * noise, 0.004), max(8 * noise, 0.006)
    known_m = np.exp(mapped + 0.3 + off)
    away = np.abs(np.log(known_m) - mapped - np.median(np.log(known_m) - mapped))
    followed = away <= max(6.95 * np.median(away), 0.005)
    assert [*followed] == [True] * 21 + [False]
    field = log_correction(np.log(coarse_m), np.stack([*places, mapped]), known_m, followed, 1)
    points = KnownDepth(np.append(x, 40), np.append(y, 5), np.append(known_m, 1.5))
    found_m, used = follow_points(prompted.card, coarse_m, frame, points)
    np.testing.assert_allclose(found_m, coarse_m * np.exp(field), rtol=1e-6)
    np.testing.assert_array_equal(used, [*followed, False])


@pytest.mark.parametrize("fit", [DepthFit.GLOBAL, DepthFit.LOCAL, DepthFit.NETWORK])
def test_fit_chooses_how_depth_follows(prompted: Pipeline, kinect: Pipeline, fit: DepthFit) -> None:
    pixels = synthetic_image()
    plain = prompted.predict(Frame(pixels)).depth.values
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 64, 6), np.arange(0, 48, 6)))
    known_m = plain[y, x] * np.where(x < 32, 1.0, 1.3)
    points = replace(KnownDepth(x, y, known_m.astype(np.float64)), fit=fit)
    ratio = prompted.predict(Frame(pixels), anchors=points).depth.values / plain
    assert (ratio[:, 50:].mean() / ratio[:, 8:14].mean() > 1.2) == (fit is not DepthFit.GLOBAL)
    with pytest.raises(InputError) if fit is DepthFit.NETWORK else nullcontext():
        kinect.predict(Frame(pixels), anchors=points)


@pytest.fixture
def needing(tmp_path: Path) -> Pipeline:
    """A model that gives the map of 8×6 that it takes as known depth."""
    fields = {"input": "lidar", "width": 8, "height": 6}
    changes = {"input__known_depth": fields, "output__scale": 1.0, "output__shift": 0.0}
    return load(write_model(tmp_path / "needing", known_depth_onnx(), **changes))


def test_a_network_that_needs_known_depth_gets_it_everywhere(needing: Pipeline) -> None:
    """Its map is not fitted once more; a pixel without a point has the depth of the nearest."""
    lidar_m = np.zeros((12, 16))
    lidar_m[:, :2], lidar_m[:, -1] = 2.0, 4.0
    points = KnownDepth.of_map(lidar_m)
    depth = needing.predict(gray(90, 120, 160), anchors=points).depth
    assert depth.provenance.anchor_fit == (36, 36, pytest.approx(0, abs=1e-6), "network")
    np.testing.assert_allclose(depth.values[:, :40], 2.0, rtol=1e-6)
    np.testing.assert_allclose(depth.values[:, 120:], 4.0, rtol=1e-6)


def test_a_network_that_needs_known_depth_gives_none_without(needing: Pipeline) -> None:
    points = KnownDepth(np.arange(5), np.arange(5), np.full(5, 2.0))
    single = KnownDepth(points.x[:1], points.y[:1], points.depth_m[:1])
    for anchors in (None, single, replace(points, fit=DepthFit.GLOBAL)):
        with pytest.raises(InputError, match="needs known depth"):
            needing.predict(gray(0), anchors=anchors)
    tiled = Pipeline(needing.session, UpsamplingOptions(tile_px=20))
    with pytest.raises(InputError, match="no tiles"):
        tiled.predict(gray(0), anchors=points)
    try_session(needing.session)
    slope_m = depth_for_trial(needing, gray(0, 6, 8)).values
    assert (slope_m[0, 0], slope_m[-1, -1]) == (1, 2)


MASKED = UpsamplingOptions(mask=DepthMask.MODEL)
SKY = {"output": "sky", "threshold": 0.5, "depth_is": "below"}


def pipeline(folder: Path, options: UpsamplingOptions = MASKED, **changes: Any) -> Pipeline:
    """The tiny network, whose map is also its sky, with a field of view of 90 degrees."""
    model = onnx.load_from_string(tiny_onnx())
    graph = model.graph
    graph.node.append(helper.make_node("Identity", ["depth"], ["sky"]))
    graph.node.append(helper.make_node("ReduceMean", ["image"], ["mean"], keepdims=0))
    graph.node.append(helper.make_node("Mul", ["mean", "zero"], ["nothing"]))
    graph.node.append(helper.make_node("Add", ["nothing", "right"], ["view"]))
    graph.initializer.append(numpy_helper.from_array(np.float32(0), "zero"))
    graph.initializer.append(numpy_helper.from_array(np.float32([90]), "right"))
    for name in ("sky", "view"):
        graph.output.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, None))
    folder = write_model(folder, model.SerializeToString(), onnx__output="depth", **changes)
    return load(folder, detail=options)


def bright_right() -> Frame:
    """Black on the left, white on the right."""
    return Frame(np.repeat(np.uint8([[0, 255]]), 16, axis=1).repeat(24, axis=0))


def test_pixels_of_the_mask_have_no_depth_if_it_is_asked_for(tmp_path: Path) -> None:
    masking = pipeline(tmp_path, output__mask=SKY)
    depth = masking.predict(bright_right()).depth.values
    assert np.isfinite(depth[:, :12]).all()
    assert np.isnan(depth[:, -12:]).all()
    transparent = replace(bright_right(), transparent=np.eye(24, 32, dtype=bool))
    depth = Pipeline(masking.session).predict(transparent).depth.values
    np.testing.assert_array_equal(np.isnan(depth), transparent.transparent)


def test_a_model_without_a_mask_has_none_to_use(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        pipeline(tmp_path).predict(bright_right())


def test_an_output_that_the_graph_lacks_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="'clouds'"):
        pipeline(tmp_path, output__mask={**SKY, "output": "clouds"})


@pytest.mark.parametrize(
    ("option_px", "source", "focal_px"),
    [(None, CameraSource.MODEL, 16), (50.0, CameraSource.OPTION, 50)],
)
def test_own_view_scales_metres_where_the_camera_is_unknown(
    tmp_path: Path, option_px: float | None, source: CameraSource, focal_px: float
) -> None:
    camera = {"focal_px": 10.0, "along": "width", "hfov_output": "view"}
    model = pipeline(tmp_path, UpsamplingOptions(), camera=camera)
    depth = model.predict(bright_right(), Intrinsics(option_px)).depth
    assert (depth.provenance.camera_source, depth.provenance.focal_px) == (
        source,
        pytest.approx(focal_px),
    )
    columns = model.card.input.width
    assert depth.values[0, 0] == pytest.approx(focal_px * columns / 32 / 10)


SHIFT = 1.5


def points(width: int, height: int, hfov_deg: float) -> np.ndarray:
    """(h, w, 3) of a wavy wall that a camera sees, without ``SHIFT`` in z."""
    focal_px = width / 2 / math.tan(math.radians(hfov_deg) / 2)
    rows, columns = np.mgrid[:height, :width] + 0.5
    z = 3 + np.sin(columns / 9) * 0.5 + rows / height
    x, y = z * (columns - width / 2) / focal_px, z * (rows - height / 2) / focal_px
    return np.stack([x, y, z - SHIFT], -1).astype(np.float32)


@pytest.mark.parametrize("size", [(80, 60), (60, 80), (200, 50)])
@pytest.mark.parametrize("hfov_deg", [30, 60, 100])
@pytest.mark.parametrize("has_view", [False, True])
def test_shift_and_view_are_those_of_the_camera(
    size: tuple[int, int], hfov_deg: float, has_view: bool
) -> None:
    cloud = points(*size, hfov_deg)
    depth, view_deg = depth_of_points(cloud, hfov_deg=hfov_deg if has_view else None)
    np.testing.assert_allclose(depth, cloud[..., 2] + SHIFT, rtol=1e-5)
    assert view_deg == pytest.approx(hfov_deg, rel=1e-5)


@pytest.mark.parametrize("count", [2, 1, 0])
def test_points_without_depth_do_not_count(count: int) -> None:
    """From two on they tell the shift; of fewer, depth is theirs, with a view of its shape."""
    cloud = points(64, 64, 60)
    bad, has_depth = np.full_like(cloud, 50), np.zeros((64, 64), bool)
    has_depth[:count, 3] = True
    bad[has_depth] = cloud[has_depth]
    depth, view_deg = depth_of_points(bad, has_depth)
    shift, expected_deg = (SHIFT, 60) if count > 1 else (0, math.degrees(2 * math.atan(0.5**0.5)))
    np.testing.assert_allclose(depth - bad[..., 2], shift, rtol=1e-4)
    assert view_deg == pytest.approx(expected_deg, rel=1e-4)


@pytest.mark.parametrize("aspect", [0.0, -1.0, math.nan, math.inf])
def test_a_pixel_has_a_width_and_a_height(kinect: Pipeline, aspect: float) -> None:
    with pytest.raises((UsageError, ZeroDivisionError)):
        kinect.predict(gray(51, pixel_aspect=aspect))
