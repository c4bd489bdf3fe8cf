"""Metres of images of any shape, with and without a focal length."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from helpers.tiny import card_with, load, point_cloud, write_model

from depthcli.core.camera import UNKNOWN_CAMERA, CameraSource, Intrinsics
from depthcli.core.types import Frame, Provenance
from depthcli.errors import InputError
from depthcli.inference.camera import focal_warnings, intrinsics_of, with_own_view
from depthcli.inference.pipeline import Pipeline, try_session
from depthcli.inference.transforms import input_layout
from depthcli.io.formats.geometry import PlyWriter
from depthcli.models.card import ModelCard

LEARNED_PX = 8 / math.tan(math.radians(30))
"""The tiny camera's focal length, in pixels of the network's 16 columns."""
FITS: tuple[dict[str, Any], ...] = (
    {"input__fit": "stretch"},
    {"input__fit": "keep-aspect"},
    {"input__fit": "keep-aspect", "input__dynamic": False},
    {"input__fit": "lower-bound"},
    {"input__fit": "upper-bound"},
)
SHAPES = [(40, 30), (30, 40), (40, 40), (64, 36), (84, 36), (200, 20), (3, 500)]
"""Width and height: landscape, portrait, square, wide, wider, panoramic, a strip."""


def black(width: int, height: int, **facts: float | None) -> Frame:
    """An image in which the tiny network sees 1 m everywhere."""
    return Frame(np.zeros((height, width), np.uint8), **facts)


def model(folder: Path, **changes: object) -> Pipeline:
    """The tiny network with a camera of 60 degrees."""
    return load(write_model(folder, **{"camera": {"hfov_deg": 60.0}, **changes}))


@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize("shape", SHAPES)
def test_metres_follow_the_focal_length_that_the_network_sees(
    tmp_path: Path, fit: dict[str, object], shape: tuple[int, int]
) -> None:
    pipeline, (width, height) = model(tmp_path, **fit), shape
    depth = pipeline.predict(black(width, height), Intrinsics(focal_px=50)).depth
    place = input_layout(pipeline.card.input, width, height)
    across, down = place.width / width, place.height / height
    seen_px = 50 * (min(across, down) if place.is_padded else math.sqrt(across * down))
    assert depth.values[0, 0] == pytest.approx(seen_px / LEARNED_PX, rel=1e-6)


def test_metres_follow_the_focal_length_as_far_as_the_network_does(tmp_path: Path) -> None:
    """Issue 56: the whole ratio put images through twice the focal length 17 % too far."""
    pipeline = model(tmp_path, camera={"hfov_deg": 60.0, "exponent": 0.75})
    near, far = (
        pipeline.predict(black(40, 30), Intrinsics(focal_px=focal_px)).depth.values
        for focal_px in (25, 50)
    )
    np.testing.assert_allclose(far / near, 2**0.75, rtol=1e-6)


@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_a_given_35mm_equivalent_counts_as_that_of_exif(tmp_path: Path, aspect: float) -> None:
    pipeline, camera = model(tmp_path), Intrinsics(pixel_aspect=aspect, focal_35mm=35)
    depth = pipeline.predict(black(40, 30), camera).depth
    exif = pipeline.predict(black(40, 30, focal_35mm=35, pixel_aspect=aspect)).depth
    np.testing.assert_array_equal(depth.values, exif.values)
    assert depth.provenance.camera_source is CameraSource.OPTION


def test_millimetres_given_as_pixels_are_a_warning(tmp_path: Path) -> None:
    for focal_px, count in ((35, 1), (150, 0)):
        camera = Intrinsics(focal_px=focal_px)
        warnings = model(tmp_path).predict(black(640, 480), camera).warnings
        assert len([text for text in warnings if "if it is in millimetres" in text]) == count


@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_assumed_camera_counts_as_if_it_had_been_given(
    tmp_path: Path, fit: dict[str, object], shape: tuple[int, int]
) -> None:
    pipeline = model(tmp_path, **fit)
    plain = pipeline.predict(black(*shape)).depth
    assert plain.provenance.camera_source is CameraSource.CARD
    same = pipeline.predict(black(*shape), Intrinsics(focal_px=plain.provenance.focal_px)).depth
    np.testing.assert_array_equal(plain.values, same.values)


@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize("shape", [(40, 30), (30, 40), (80, 32), (200, 20)])
@pytest.mark.parametrize("aspect", [2.0, 0.5])
@pytest.mark.parametrize("camera", [{"focal_px": 50.0}, {"hfov_deg": 40.0}, {"exif": 30.0}, {}])
def test_squeezed_images_have_the_metres_and_the_points_of_square_ones(
    tmp_path: Path,
    fit: dict[str, object],
    shape: tuple[int, int],
    aspect: float,
    camera: dict[str, float],
) -> None:
    pipeline, (width, height) = model(tmp_path, **fit), shape
    given, exif = camera.copy(), camera.get("exif")
    given.pop("exif", None)
    square = pipeline.predict(black(width, height, focal_35mm=exif), Intrinsics(**given)).depth
    if "focal_px" in given:
        given["focal_px"] /= aspect
    squeezed = black(round(width / aspect), height, focal_35mm=exif, pixel_aspect=aspect)
    depth = pipeline.predict(squeezed, Intrinsics(**given)).depth
    assert depth.provenance.input_size_px == square.provenance.input_size_px
    assert depth.provenance.pixel_aspect == aspect
    assert depth.values[0, 0] == pytest.approx(square.values[0, 0], rel=1e-6)
    clouds = [point_cloud(one, one.provenance.focal_px).xyz_m for one in (square, depth)]
    for cloud, pixel_width in zip(clouds, (1, aspect), strict=True):
        half_pixels = np.float32([(width - pixel_width) / 2, (height - 1) / 2])
        focal_px = square.provenance.focal_px
        expected = half_pixels / focal_px * square.values[0, 0]
        np.testing.assert_allclose(cloud.max(0)[:2], expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("size", "from_px"),
    [
        ((40, 30), 40),
        ((30, 40), 40),
        ((30, 30), 40),
        ((40, 20), 40),
        ((20, 40), 40),
        ((39, 30), 40),
    ],
)
@pytest.mark.parametrize("upright", [False, True])
def test_other_shapes_are_taken_for_crops_of_the_learned_camera_s_images(
    tmp_path: Path, size: tuple[int, int], from_px: int, upright: bool
) -> None:
    """The learned frame is 60 degrees over its longer side, whichever that is."""
    hfov_deg = math.degrees(2 * math.atan(0.75 * math.tan(math.radians(30)))) if upright else 60
    turned = {"input__width": 12, "input__height": 16} if upright else {}
    pipeline = model(tmp_path, camera={"hfov_deg": hfov_deg}, **turned)
    source = pipeline.predict(black(*size)).depth.provenance
    assert source.focal_px == pytest.approx(from_px / 2 / math.tan(math.radians(30)))


@pytest.mark.parametrize("fit", ["stretch", "keep-aspect"])
def test_a_network_that_learned_squeezed_images(tmp_path: Path, fit: str) -> None:
    """4:3 at 12 x 12: what it learned is a focal length between those of both axes."""
    squeezed = {"input__width": 12, "input__fit": fit, "input__pixel_aspect": 4 / 3}
    pipeline = model(tmp_path, **squeezed)
    learned_px = 20 / math.tan(math.radians(30))
    depth = pipeline.predict(black(40, 30), Intrinsics(focal_px=learned_px)).depth
    assert depth.provenance.input_size_px == (12, 12)
    np.testing.assert_allclose(depth.values, 1, rtol=1e-6)
    assumed = pipeline.predict(black(40, 30)).depth.provenance
    assert assumed.focal_px == pytest.approx(learned_px)
    assert '"pixel_aspect": 1.3333333333333333' in pipeline.card.to_json()
    assert ModelCard.from_json(pipeline.card.to_json()) == pipeline.card


def test_the_focal_length_given_wins_over_exif_and_exif_over_the_card(tmp_path: Path) -> None:
    pipeline, frame = model(tmp_path), black(40, 30, focal_35mm=50.0)
    sources = [
        pipeline.predict(frame, Intrinsics(focal_px=40)).depth.provenance,
        pipeline.predict(frame, Intrinsics(hfov_deg=90)).depth.provenance,
        pipeline.predict(frame).depth.provenance,
        pipeline.predict(black(40, 30)).depth.provenance,
    ]
    found = [(source.camera_source, source.focal_px) for source in sources if source]
    exif_px = 50 * 50 / math.hypot(36, 24)  # the image's diagonal is 50 pixels
    assert found == [
        (CameraSource.OPTION, 40),
        (CameraSource.OPTION, pytest.approx(20)),
        (CameraSource.EXIF, pytest.approx(exif_px)),
        (CameraSource.CARD, pytest.approx(20 / math.tan(math.radians(30)))),
    ]


def test_exif_is_known_to_clouds_of_models_that_learned_no_camera(tmp_path: Path) -> None:
    pipeline = load(write_model(tmp_path, camera=None))
    depth = pipeline.predict(black(40, 30, focal_35mm=50.0)).depth
    assert depth.provenance.camera_source is CameraSource.EXIF
    np.testing.assert_array_equal(depth.values, 1)
    assert pipeline.predict(black(40, 30)).depth.provenance == replace(
        depth.provenance, focal_px=None, camera_source=None
    )


def test_a_point_cloud_has_the_camera_of_its_metres(tmp_path: Path) -> None:
    pipeline = model(tmp_path / "tiny", input__fit="keep-aspect")
    for words in ({}, {"focal_px": 25.0}):
        depth = pipeline.predict(black(30, 40), Intrinsics(**words)).depth
        warnings = PlyWriter().write(depth, tmp_path / "a.ply")
        assert bool(warnings) == (not words)
        data = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")[2]
        points = np.frombuffer(data, [("xyz", "<f4", 3), ("rgb", "u1", 3)])["xyz"]
        focal_px = (points[0, 2] * (0.5 - 15)) / points[0, 0]
        assert focal_px == pytest.approx(depth.provenance.focal_px, rel=1e-5)


@pytest.mark.parametrize(
    "changes", [{"camera": None}, {"output__kind": "relative"}, {"output__kind": "inverse"}]
)
def test_map_without_metres_of_a_camera_stays(tmp_path: Path, changes: dict[str, Any]) -> None:
    pipeline = model(tmp_path, **changes)
    plain = pipeline.predict(black(40, 30)).depth
    stated = pipeline.predict(black(40, 30, focal_35mm=20.0)).depth
    np.testing.assert_array_equal(stated.values, plain.values)
    assert plain.provenance == Provenance("tiny", pipeline.session.model.sha256, (16, 12), None, 1)
    focal_px = 20 * math.hypot(40, 30) / math.hypot(36, 24)
    assert stated.provenance == replace(
        plain.provenance, focal_px=pytest.approx(focal_px), camera_source=CameraSource.EXIF
    )
    given = pipeline.predict(black(40, 30), Intrinsics(focal_px=50)).depth
    np.testing.assert_array_equal(given.values, plain.values)
    assert given.provenance == replace(
        plain.provenance, focal_px=50, camera_source=CameraSource.OPTION
    )
    for lens, count in (
        (UNKNOWN_CAMERA, 0),
        (Intrinsics(focal_px=50), 1),
        (Intrinsics(hfov_deg=60), 1),
    ):
        assert len(focal_warnings(pipeline.card, lens)) == count
    assert not focal_warnings(model(tmp_path / "known").card, Intrinsics(focal_px=50))


@pytest.mark.parametrize(
    ("size", "facts", "given", "told"),
    [
        ((40, 30), {"focal_mm": 36.0}, {}, "36 mm"),
        ((40, 30), {"focal_mm": 36.0}, {"hfov_deg": 50}, ""),
        ((40, 30), {"focal_mm": 36.0, "focal_35mm": 50.0}, {}, ""),
        ((40, 30), {}, {}, ""),
        ((200, 40), {"focal_35mm": 26.0}, {}, "panorama"),
        ((40, 200), {"focal_35mm": 26.0}, {}, "panorama"),
        ((200, 40), {"focal_35mm": 26.0}, {"hfov_deg": 50}, ""),
        ((210, 90), {"focal_35mm": 26.0}, {}, ""),
    ],
)
def test_a_focal_length_that_may_not_be_that_of_the_image_is_told(
    tmp_path: Path,
    size: tuple[int, int],
    facts: dict[str, float],
    given: dict[str, float],
    told: str,
) -> None:
    """Phones (CustomRendered 6 of iOS) keep the lens's 35-mm equivalent in panoramas."""
    found = model(tmp_path).predict(black(*size, **facts), Intrinsics(**given)).warnings
    assert {word for word in ("36 mm", "panorama") if word in str(found)} == {told} - {""}


def test_a_focal_length_of_the_input_scales_metres(tmp_path: Path) -> None:
    pipeline = model(tmp_path, camera={"focal_px": 20.0}, input__fit="lower-bound")
    depth = pipeline.predict(black(160, 120), Intrinsics(focal_px=100)).depth
    assert depth.values[0, 0] == pytest.approx(100 / 10 / 20)  # of 16 columns from 160


@pytest.mark.parametrize("pixel_aspect", [1.0, 4 / 3])
@pytest.mark.parametrize(
    ("along", "factor"), [("width", 0.1), ("mean", (0.1 + 0.3) / 2), ("both", math.sqrt(0.1 * 0.3))]
)
def test_a_focal_length_is_along_the_card_s_axis(
    tmp_path: Path, along: str, factor: float, pixel_aspect: float
) -> None:
    camera = {"focal_px": 16.0, "along": along}
    changes = {"input__dynamic": False, "input__pixel_aspect": pixel_aspect}
    depth = model(tmp_path, camera=camera, **changes).predict(black(160, 40), Intrinsics(80)).depth
    learned_px = 16 * (1 if along == "width" else math.sqrt(pixel_aspect))
    assert depth.values[0, 0] == pytest.approx(80 * factor / learned_px)


@pytest.mark.parametrize(
    ("own", "given", "source", "focal_px"),
    [
        (90.0, {}, CameraSource.MODEL, 20),
        (90.0, {"focal_px": 30.0}, CameraSource.OPTION, 30),
        (200.0, {}, CameraSource.CARD, 40 / 2 / math.tan(math.radians(30))),
        (None, {}, CameraSource.CARD, 40 / 2 / math.tan(math.radians(30))),
    ],
)
def test_own_view_counts_where_the_camera_is_unknown(
    own: float | None, given: dict[str, float], source: CameraSource, focal_px: float
) -> None:
    card = ModelCard.from_json(json.dumps(card_with({"camera": {"hfov_deg": 60.0}})))
    camera = intrinsics_of(card, black(40, 30), Intrinsics(**given))
    found = with_own_view(camera, own, 40)
    assert (found.source, found.focal_px) == (source, pytest.approx(focal_px))


def camera_onnx(row: int, column: int) -> bytes:
    """A network of an image and a camera matrix, whose depth is one number of the matrix."""
    image = onnx.helper.make_tensor_value_info("image", 1, ["n", 1, "h", "w"])
    camera = onnx.helper.make_tensor_value_info("intrinsics", 1, ["n", 3, 3])
    depth = onnx.helper.make_tensor_value_info("depth", 1, ["n", 1, "h", "w"])
    arrays = {"zero": np.float32(0), "shape": np.array([-1, 1, 1, 1])}
    arrays |= {"row": np.array(row), "column": np.array(column)}
    nodes = [
        onnx.helper.make_node("Mul", ["image", "zero"], ["nothing"]),
        onnx.helper.make_node("Gather", ["intrinsics", "row"], ["numbers"], axis=1),
        onnx.helper.make_node("Gather", ["numbers", "column"], ["number"], axis=1),
        onnx.helper.make_node("Reshape", ["number", "shape"], ["one"]),
        onnx.helper.make_node("Add", ["nothing", "one"], ["depth"]),
    ]
    tensors = [onnx.numpy_helper.from_array(np.asarray(a), name) for name, a in arrays.items()]
    graph = onnx.helper.make_graph(nodes, "camera", [image, camera], [depth], tensors)
    opset = [onnx.helper.make_opsetid("", 17)]
    return onnx.helper.make_model(graph, opset_imports=opset, ir_version=8).SerializeToString()


@pytest.mark.parametrize(
    ("row", "column", "expected"),  # 40x30 pixels become 16x12
    [(0, 0, 50 * 0.4), (1, 1, 50 * 1.5 * 0.4), (0, 2, 16 * 0.4 - 0.5), (1, 2, 20.5 * 0.4 - 0.5)],
)
def test_a_network_gets_the_camera_matrix_in_its_own_pixels(
    tmp_path: Path, row: int, column: int, expected: float
) -> None:
    spec = {"input__camera_matrix": "intrinsics", "input__fit": "stretch"}
    depth = {"output__scale": 1, "output__shift": 0, "output__min_m": 0.01, "output__max_m": 99.0}
    folder = write_model(tmp_path, camera_onnx(row, column), camera=None, **spec, **depth)
    pipeline = load(folder)
    try_session(pipeline.session)
    lens = Intrinsics(focal_px=50, centre_px=(15.5, 20.0), pixel_aspect=1.5)
    values = pipeline.predict(black(40, 30), lens).depth.values
    np.testing.assert_allclose(values, expected, rtol=1e-5)
    with pytest.raises(InputError, match="needs the focal length"):
        pipeline.predict(black(40, 30))
