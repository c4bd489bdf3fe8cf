"""Metres of images of any shape, with and without a focal length."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx.parser
import pytest
from helpers.tiny import load, point_cloud, write_model

from depthcli.core.camera import UNKNOWN_CAMERA, CameraSource, Intrinsics
from depthcli.core.types import Frame, Provenance
from depthcli.errors import InputError
from depthcli.inference.pipeline import Pipeline, try_session
from depthcli.inference.transforms import focal_warnings

FITS: tuple[dict[str, Any], ...] = (
    {"input__fit": "stretch"},
    {"input__fit": "keep-aspect"},
    {"input__fit": "keep-aspect", "input__dynamic": False},
    {"input__fit": "lower-bound"},
    {"input__fit": "upper-bound"},
)


def black(width: int, height: int, **facts: float | None) -> Frame:
    """An image in which the tiny network sees 1 m everywhere."""
    return Frame(np.zeros((height, width), np.uint8), **facts)


def model(folder: Path, **changes: object) -> Pipeline:
    """The tiny network with a camera of 60 degrees."""
    return load(write_model(folder, **{"camera": {"hfov_deg": 60.0}, **changes}))


def test_metres_follow_the_focal_length_as_far_as_the_network_does(tmp_path: Path) -> None:
    """The whole ratio put images through twice the focal length 17 % too far."""
    pipeline = model(tmp_path, camera={"hfov_deg": 60.0, "exponent": 0.75})
    near, far = (
        pipeline.predict(black(40, 30), Intrinsics(focal_px=focal_px)).depth.values
        for focal_px in (25, 50)
    )
    np.testing.assert_allclose(far / near, 2**0.75, rtol=1e-6)


def test_millimetres_given_as_pixels_are_a_warning(tmp_path: Path) -> None:
    for focal_px, count in ((35, 1), (150, 0)):
        camera = Intrinsics(focal_px=focal_px)
        warnings = model(tmp_path).predict(black(640, 480), camera).warnings
        assert len([text for text in warnings if "if it is in millimetres" in text]) == count


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
    options, exif = camera.copy(), camera.get("exif")
    options.pop("exif", None)
    square = pipeline.predict(black(width, height, focal_35mm=exif), Intrinsics(**options)).depth
    facts = {"pixel_aspect": aspect}
    if "focal_px" in options:  # as of a calibration, which knows of the pixels, too
        options, facts = facts | {"focal_px": options["focal_px"] / aspect}, {}
    squeezed = black(round(width / aspect), height, focal_35mm=exif, **facts)
    depth = pipeline.predict(squeezed, Intrinsics(**options)).depth
    assert depth.provenance.input_size_px == square.provenance.input_size_px
    assert depth.provenance.pixel_aspect == aspect
    assert depth.values[0, 0] == pytest.approx(square.values[0, 0], rel=1e-6)
    clouds = [point_cloud(map_, map_.provenance.focal_px).xyz_m for map_ in (square, depth)]
    for cloud, pixel_width in zip(clouds, (1, aspect), strict=True):
        half_pixels = np.float32([(width - pixel_width) / 2, (height - 1) / 2])
        focal_px = square.provenance.focal_px
        expected = half_pixels / focal_px * square.values[0, 0]
        np.testing.assert_allclose(cloud.max(0)[:2], expected, rtol=1e-5)


@pytest.mark.parametrize("size", [(40, 30), (30, 40), (30, 30), (40, 20), (20, 40), (39, 30)])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"input__width": 12, "input__height": 16},
        {"input__height": 18, "input__pixel_aspect": 1.5},
    ],
)
def test_other_shapes_are_taken_for_crops_of_the_learned_camera_s_images(
    tmp_path: Path, size: tuple[int, int], changes: dict[str, float]
) -> None:
    """The learned frame is 60 degrees over its longer side, whichever that is."""
    across = math.tan(math.radians(30)) * changes.get("input__width", 16) / 16
    camera = {"hfov_deg": math.degrees(2 * math.atan(across))}
    pipeline = model(tmp_path, camera=camera, **changes)
    source = pipeline.predict(black(*size)).depth.provenance
    assert source.focal_px == pytest.approx(20 / math.tan(math.radians(30)))


@pytest.mark.parametrize(
    ("camera", "exif_mm", "source", "focal_px"),
    [
        (Intrinsics(focal_px=40), 50.0, CameraSource.OPTION, 40),
        (Intrinsics(hfov_deg=90), 50.0, CameraSource.OPTION, 20),
        (UNKNOWN_CAMERA, 50.0, CameraSource.EXIF, 50 * 50 / math.hypot(36, 24)),  # of 50 pixels
        (UNKNOWN_CAMERA, None, CameraSource.CARD, 20 / math.tan(math.radians(30))),
    ],
)
def test_the_focal_length_given_wins_over_exif_and_exif_over_the_card(
    tmp_path: Path, camera: Intrinsics, exif_mm: float, source: CameraSource, focal_px: float
) -> None:
    provenance = model(tmp_path).predict(black(40, 30, focal_35mm=exif_mm), camera).depth.provenance
    assert (provenance.camera_source, provenance.focal_px) == (source, pytest.approx(focal_px))


@pytest.mark.parametrize(
    "changes", [{"camera": None}, {"output__kind": "relative"}, {"output__kind": "inverse"}]
)
def test_map_without_metres_of_a_camera_stays(tmp_path: Path, changes: dict[str, Any]) -> None:
    pipeline = model(tmp_path, **changes)
    plain = pipeline.predict(black(40, 30, timestamp_s=2.5)).depth
    with_exif = pipeline.predict(black(40, 30, focal_35mm=20.0, timestamp_s=2.5)).depth
    np.testing.assert_array_equal(with_exif.values, plain.values)
    sha256 = pipeline.session.model.sha256
    assert plain.provenance == Provenance("tiny", sha256, (16, 12), None, 1, time_s=2.5)
    focal_px = 20 * math.hypot(40, 30) / math.hypot(36, 24)
    assert with_exif.provenance == replace(
        plain.provenance, focal_px=pytest.approx(focal_px), camera_source=CameraSource.EXIF
    )
    with_option = pipeline.predict(black(40, 30), Intrinsics(focal_px=50, centre_px=(9, 8))).depth
    np.testing.assert_array_equal(with_option.values, plain.values)
    assert with_option.provenance == Provenance(
        "tiny", sha256, (16, 12), 50, 1, camera_source=CameraSource.OPTION, centre_px=(9, 8)
    )
    for lens, count in (
        (UNKNOWN_CAMERA, 0),
        (Intrinsics(focal_px=50), 1),
        (Intrinsics(hfov_deg=60), 1),
    ):
        assert len(focal_warnings(pipeline.card, lens)) == count
    assert not focal_warnings(model(tmp_path / "known").card, Intrinsics(focal_px=50))


@pytest.mark.parametrize(
    ("size", "facts", "options", "expected"),
    [
        ((40, 30), {"focal_mm": 36.0}, {}, "36 mm"),
        ((40, 30), {"focal_mm": 36.0}, {"hfov_deg": 50}, ""),
        ((40, 30), {"focal_mm": 36.0, "focal_35mm": 50.0}, {}, ""),
        ((40, 30), {}, {}, ""),
        ((101, 40), {"focal_35mm": 26.0}, {}, "panorama"),
        ((40, 101), {"focal_35mm": 26.0}, {}, "panorama"),
        ((200, 40), {"focal_35mm": 26.0}, {"hfov_deg": 50}, ""),
        ((100, 40), {"focal_35mm": 26.0}, {}, ""),
    ],
)
def test_a_focal_length_that_may_not_be_that_of_the_image_is_told(
    tmp_path: Path,
    size: tuple[int, int],
    facts: dict[str, float],
    options: dict[str, float],
    expected: str,
) -> None:
    """Phones (CustomRendered 6 of iOS) keep the lens's 35-mm equivalent in panoramas."""
    warnings = model(tmp_path).predict(black(*size, **facts), Intrinsics(**options)).warnings
    assert {word for word in ("36 mm", "panorama") if word in str(warnings)} == {expected} - {""}


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


@pytest.mark.parametrize("pixel_aspect", [1.0, 4 / 3])
@pytest.mark.parametrize("size", [(160, 40), (40, 160)])
def test_a_padded_image_is_scaled_as_the_axis_that_it_fills(
    tmp_path: Path, size: tuple[int, int], pixel_aspect: float
) -> None:
    changes = {"input__dynamic": False, "input__pixel_aspect": pixel_aspect}
    padded = model(tmp_path, camera={"focal_px": 16.0}, input__fit="keep-aspect", **changes)
    columns_a_pixel = min(16 / size[0], 12 / size[1] / pixel_aspect)
    values = padded.predict(black(*size), Intrinsics(80)).depth.values
    assert values[0, 0] == pytest.approx(80 * columns_a_pixel / 16)


@pytest.mark.parametrize(
    ("size", "centre_px", "focal_px", "expected_px"),  # of pixels of 3:2, in 16x12 square ones
    [
        ((40, 20), None, (50 * 0.4, 75 * 0.25), (7.5, 3 + 2.5 - 0.5)),  # 16x5, 3 rows above it
        ((40, 20), (15.5, 12), (50 * 0.4, 75 * 0.25), (16 * 0.4 - 0.5, 3 + 12.5 * 0.25 - 0.5)),
        ((20, 40), None, (50 * 0.45, 75 * 0.3), (3 + 4.5 - 0.5, 5.5)),  # 9x12, 3 columns before it
        ((20, 40), (15.5, 12), (50 * 0.45, 75 * 0.3), (3 + 16 * 0.45 - 0.5, 12.5 * 0.3 - 0.5)),
    ],
)
def test_a_network_gets_the_camera_matrix_in_its_own_pixels(
    tmp_path: Path,
    size: tuple[int, int],
    centre_px: tuple[float, float] | None,
    focal_px: tuple[float, float],
    expected_px: tuple[float, float],
) -> None:
    """One whose depth is a sum of the matrix's numbers, each with a weight of its own."""
    network = """
        <ir_version: 8, opset_import: ["": 17]>
        camera (float[n,1,h,w] image, float[n,3,3] intrinsics) => (float[n,1,h,w] depth)
        <float[3,3] weights = {0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9}> {
            weighted = Mul(intrinsics, weights)
            total = ReduceSum(weighted)
            nothing = Sub(image, image)
            depth = Add(nothing, total)
        }"""
    spec = {"input__camera_matrix": "intrinsics", "input__fit": "keep-aspect"}
    spec |= {"output__scale": 1, "output__shift": 0, "output__max_m": 99.0, "input__dynamic": False}
    data = onnx.parser.parse_model(network).SerializeToString()
    pipeline = load(write_model(tmp_path, data, camera=None, **spec))
    try_session(pipeline.session)
    lens = Intrinsics(focal_px=50, centre_px=centre_px, pixel_aspect=1.5)
    values = pipeline.predict(black(*size), lens).depth.values
    (fx, fy), (x, y) = focal_px, expected_px
    expected = 0.1 * fx + 0.3 * x + 0.5 * fy + 0.6 * y + 0.9
    np.testing.assert_allclose(values, expected, rtol=1e-5)
    with pytest.raises(InputError, match="needs the focal length"):
        pipeline.predict(black(40, 30))
