"""Depth to steps, shares and light, as plain Python computes them one pixel at a time."""

import json
import math
import statistics
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from PIL import Image

from depthcli.core.camera import CameraSource
from depthcli.core.types import DepthKind, DepthMap, Frame, Provenance
from depthcli.errors import InputError
from depthcli.io.exr.file import read_exr_channels, write_exr
from depthcli.io.formats.raster import SidecarWriter, stretched
from depthcli.io.formats.table import WriterOptions
from depthcli.io.images.read import frame_of
from depthcli.io.stored.metadata import denormalized, normalized

F32 = np.float32
DEPTHS = st.one_of(
    st.floats(-1, 100, width=32), st.sampled_from([0.0, -0.0, math.nan, math.inf, -math.inf])
)
MAPS = st.lists(DEPTHS, min_size=1, max_size=12).map(lambda row: np.array([row], F32))


@pytest.mark.parametrize("kind", DepthKind)
@settings(max_examples=40)
@given(MAPS)
def test_stretched(kind: DepthKind, values: np.ndarray) -> None:
    lowest = 0 if kind is DepthKind.METRIC else -math.inf
    steps, (low, high), saturated = stretched(DepthMap(values, kind), WriterOptions())
    valid = [float(value) for value in values[0] if lowest < value < math.inf]
    ends = (min(valid), max(valid)) if valid else (0.0, 0.0)
    assert (low, high, saturated) == (*ends, 0)
    np.testing.assert_array_equal(stretched(DepthMap(values.T, kind), WriterOptions())[0], steps.T)
    for value, step in zip(values[0].tolist(), steps[0].tolist(), strict=True):
        share = (value - low) / (high - low or 1.0)
        assert step == (np.rint(1 + share * 65534) if value in valid else 0)


@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_every_normalized_step_is_read_as_it_was_written(precision: type) -> None:
    steps = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    values = denormalized(steps, 1, 3)
    assert np.isnan(values[0, 0])
    assert (values[0, 1], values[-1, -1]) == (1, 3)
    again = normalized(values.astype(precision), ~np.isnan(values), 1, 3)
    np.testing.assert_array_equal(again, steps)
    shares = (F32(steps) - 1) / F32(65534)
    np.testing.assert_array_equal(denormalized(steps, 0, 1).ravel()[1:], shares.ravel()[1:])


@pytest.mark.parametrize("window", ["dataWindow", "displayWindow"])
def test_an_exr_that_claims_too_much_is_not_decoded(window: str, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"Y": np.ones((3, 4), F32)}, {})
    assert read_exr_channels(path, max_pixels=12)["Y"].pixels.shape == (3, 4)
    data, value = path.read_bytes(), b"\0box2i\0\x10\0\0\0"
    at = data.index(window.encode() + value) + len(window) + len(value)
    claim = np.array([-1, -2, 3, 2], "<i4").tobytes()
    path.write_bytes(data[:at] + claim + data[at + 16 :])
    with pytest.raises(InputError):
        read_exr_channels(path, max_pixels=12)


def test_an_exr_whose_pixels_are_damaged_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"Y": np.add.outer(np.arange(40), np.arange(50)).astype(F32)}, {})
    path.write_bytes(path.read_bytes()[:-30] + bytes(30))
    with pytest.raises(InputError):
        read_exr_channels(path)


def test_every_fact_of_a_map_stands_in_its_sidecar(tmp_path: Path) -> None:
    card = CameraSource.CARD
    source = Provenance("m", "ab", (8, 6), focal_px=3.0, orientation=6, camera_source=card)
    values = F32([[1, 2, 4, np.nan], [np.inf, 5, 9, 3]])
    path = tmp_path / "a.json"
    SidecarWriter().write(DepthMap(values, provenance=source), path)
    text = path.read_text()
    document = json.loads(text)
    assert text == json.dumps(document, indent=2) + "\n"
    finite = [1, 2, 4, 5, 9, 3]
    hfov_deg = 2 * math.degrees(math.atan(4 / 2 / 3))
    del document["software"]
    assert document == {
        "kind": "metric",
        "unit": "m",
        "png16_scale": 1000.0,
        "width": 4,
        "height": 2,
        "min": 1,
        "median": statistics.median(finite),
        "max": 9,
        "orientation": 6,
        "model": "m",
        "model_sha256": "ab",
        "network_size_px": [8, 6],
        "anchors": None,
        "focal_px": 3.0,
        "centre_px": None,
        "camera_source": "card",
        "pixel_aspect": 1.0,
        "camera": f"hfov {hfov_deg:.1f}° (assumed, from the model's card)",
    }
    inverse = DepthMap(np.full((1, 2), np.nan, F32), DepthKind.INVERSE)
    SidecarWriter().write(inverse, path, Frame(np.zeros((1, 2), np.uint8), orientation=3))
    document = json.loads(path.read_text())
    assert {name for name, value in document.items() if value is not None} == {
        *("software", "kind", "width", "height", "orientation", "pixel_aspect")
    }
    assert document["orientation"] == 3
    SidecarWriter(png_normalize=True).write(DepthMap(values), path)
    assert json.loads(path.read_text())["png16_scale"] is None


PIXELS = np.arange(200, 224, dtype=np.uint8).reshape(2, 3, 4)


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (PIXELS[..., 0], PIXELS[..., 0]),
        (PIXELS[..., :1], PIXELS[..., 0]),
        (PIXELS[..., :2], PIXELS[..., 0]),
        (PIXELS[..., :3], PIXELS[..., :3]),
        (PIXELS, PIXELS[..., :3]),
        (PIXELS[..., 0].astype(">u2"), PIXELS[..., 0]),
        (PIXELS[:, ::-1, :3], PIXELS[:, ::-1, :3]),
    ],
)
def test_arrays_as_images(image: np.ndarray, expected: np.ndarray) -> None:
    frame = frame_of(image)
    np.testing.assert_array_equal(frame.pixels, expected)
    assert frame.pixels.dtype.isnative
    assert not np.shares_memory(frame.pixels, PIXELS)
    assert frame_of(frame) is frame


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "I;16"])
def test_pil_images(mode: str, tmp_path: Path) -> None:
    gray = Image.fromarray(PIXELS[..., 0] * 9)
    image = gray.convert("I").convert(mode) if mode == "I;16" else gray.convert(mode)
    frame = frame_of(image)
    colours = image if mode == "I;16" else image.convert("L" if mode in "1LA" else "RGB")
    np.testing.assert_array_equal(frame.pixels, np.array(colours))
    assert (frame.path, frame.orientation, frame.focal_35mm) == (None, 1, None)
    if mode != "RGB":
        return
    facts = Image.Exif()
    for orientation, focal, expected in (
        (6, 28, (6, 28.0)),
        (9, 0, (1, None)),
        (0, 3, (1, 3.0)),
        (1, 1, (1, None)),
    ):
        facts[0x0112] = orientation
        facts.get_ifd(0x8769)[0xA405] = focal
        image.save(tmp_path / "a.png", exif=facts)
        with Image.open(tmp_path / "a.png") as opened:
            frame = frame_of(opened)
            copied = frame_of(opened.copy())
        assert (frame.orientation, frame.focal_35mm) == expected
        assert frame.path == tmp_path / "a.png"
        upright = np.rot90(np.array(image), 3) if orientation == 6 else np.array(image)
        np.testing.assert_array_equal(frame.pixels, upright)
        np.testing.assert_array_equal(frame.pixels, frame_of(tmp_path / "a.png").pixels)
        np.testing.assert_array_equal(copied.pixels, np.array(image))
        assert copied.orientation == 1
