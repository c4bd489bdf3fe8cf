"""Depth that phones store within their images."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from helpers import made
from helpers.heifs import heic
from PIL import Image

from depthcli.core.types import DepthKind
from depthcli.errors import InputError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.images import heif

SHADES = np.arange(256, dtype=np.uint8).reshape(16, 16)
EMPTY = made.jpeg([[128]])


@pytest.mark.parametrize("form", ["RangeInverse", "RangeLinear"])
@pytest.mark.parametrize("orientation", [1, 6])
def test_gdepth_of_a_jpeg_is_read_upright(form: str, orientation: int, tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    facts = {"Format": form, "Near": "0.5", "Far": "8", "Units": "m"}
    path.write_bytes(made.jpeg_with_depth(EMPTY, SHADES, orientation=orientation, **facts))
    depth = read_stored_depth(path).depth
    share = SHADES / 255
    inverse_m, linear_m = 1 / (1 / 0.5 + share * (1 / 8 - 1 / 0.5)), 0.5 + share * 7.5
    expected_m = np.rot90(inverse_m if form == "RangeInverse" else linear_m, -(orientation == 6))
    assert depth.kind is DepthKind.METRIC
    np.testing.assert_allclose(depth.values, expected_m, rtol=1e-5)


def test_dynamic_depth_after_a_jpeg_is_read(tmp_path: Path) -> None:
    Image.fromarray(SHADES).save(file := BytesIO(), "PNG")
    depth, other = file.getvalue(), b"confidence"
    facts = ('Format="RangeInverse"', 'Near="0.5"', 'Far="8"', 'Units="Meters"')
    items = (("Primary", 0), ("Depth", len(depth)), ("Confidence", len(other)))
    xmp = "".join(
        f'<Container:Item Item:Semantic="{n}" Item:Length="{size}"/>' for n, size in items
    )
    xmp += "<x " + " ".join(f"DepthMap:{fact}" for fact in facts) + "/>"
    head = made.segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + xmp.encode())
    (tmp_path / "a.jpg").write_bytes(EMPTY[:2] + head + EMPTY[2:] + depth + other)
    stored = read_stored_depth(tmp_path / "a.jpg").depth
    assert stored.kind is DepthKind.METRIC
    assert (stored.values[0, 0], stored.values[-1, -1]) == (0.5, 8)


def test_gdepth_without_a_unit_is_relative(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(made.jpeg_with_depth(EMPTY, SHADES, Format="RangeLinear", Near="1", Far="2"))
    assert read_stored_depth(path).depth.kind is DepthKind.RELATIVE
    path.write_bytes(made.jpeg_with_depth(EMPTY, SHADES, Format="RangeLinear", Near="1"))
    with pytest.raises(InputError):
        read_stored_depth(path)
    path.write_bytes(EMPTY)
    with pytest.raises(InputError):
        read_stored_depth(path)


@pytest.mark.parametrize(
    ("facts", "near_m", "far_m"),
    [
        ({"representation_type": 1, "d_min": 1.498, "d_max": 4.383}, 1 / 4.383, 1 / 1.498),
        ({"representation_type": 0, "z_near": 0.5, "z_far": 2.0}, 0.5, 2.0),
        ({"representation_type": 2, "z_near": 0.5, "z_far": 2.0}, 0.5, 2.0),
    ],
)
def test_depth_image_of_a_heic_is_in_metres(
    facts: dict[str, float],
    near_m: float,
    far_m: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As of an iPhone 13 Pro, whose disparity is uniform and marked as relative."""
    monkeypatch.setattr(heif, "depth_images", lambda _: [(SHADES, facts)])
    path = tmp_path / "a.heic"
    picture = heic(np.zeros((64, 64, 3), np.uint8))
    path.write_bytes(picture + b"<depthData:Accuracy>relative</depthData:Accuracy>")
    stored = read_stored_depth(path)
    assert stored.depth.is_metric
    assert len(stored.warnings) == 1
    assert stored.depth.values.min() == pytest.approx(near_m)
    assert stored.depth.values.max() == pytest.approx(far_m)


def test_heic_without_depth_is_no_depth_file(tmp_path: Path) -> None:
    (tmp_path / "a.heic").write_bytes(heic(np.zeros((64, 64, 3), np.uint8)))
    with pytest.raises(InputError):
        read_stored_depth(tmp_path / "a.heic")
