"""Pictures come in at their own precision and upright; bad ones are refused with a reason."""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from helpers import made
from hypothesis import given
from hypothesis import strategies as st

from depthcli.errors import InputError
from depthcli.io.images.exif import read_exif
from depthcli.io.images.read import read_image

if TYPE_CHECKING:
    from pathlib import Path

PICTURE = np.random.default_rng(0).integers(0, 255, (6, 9, 3), dtype=np.uint8)


def encoded(suffix: str, rgb: np.ndarray = PICTURE) -> bytes:
    bgr = rgb[..., ::-1] if rgb.ndim == 3 else rgb
    ok, data = cv2.imencode(suffix, np.ascontiguousarray(bgr))
    assert ok
    return data.tobytes()


def with_exif(jpeg: bytes, orientation: int, focal_35mm: int = 28) -> bytes:
    entry = struct.Struct("<HHII")
    first = struct.pack("<H", 2) + entry.pack(0x0112, 3, 1, orientation)
    first += entry.pack(0x8769, 4, 1, 8 + 2 + 24 + 4) + struct.pack("<I", 0)
    inner = struct.pack("<H", 1) + entry.pack(0xA405, 3, 1, focal_35mm) + struct.pack("<I", 0)
    body = b"Exif\0\0" + b"II*\0" + struct.pack("<I", 8) + first + inner
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:]


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".bmp"])
def test_lossless_pictures_are_exact(suffix: str) -> None:
    assert (read_image(None, encoded(suffix)).pixels == PICTURE).all()


@pytest.mark.parametrize("suffix", [".jpg", ".webp", ".avif"])
def test_lossy_pictures_have_their_size(suffix: str) -> None:
    assert read_image(None, encoded(suffix)).pixels.shape == PICTURE.shape


@pytest.mark.parametrize(("transfer", "name"), [(16, "PQ"), (18, "HLG"), (13, None)])
def test_high_dynamic_range_of_avif_is_told(transfer: int, name: str | None) -> None:
    data = encoded(".avif")
    at = data.index(b"colrnclx") + len(b"colrnclx") + 2
    warnings = read_image(None, data[:at] + transfer.to_bytes(2) + data[at + 2 :]).warnings
    assert [f"({name})" in text for text in warnings] == ([True] if name else [])


def test_sixteen_bits_stay_sixteen_bits() -> None:
    deep = np.arange(0, 65520, 1820, dtype=np.uint16).reshape(4, 9)
    assert (read_image(None, encoded(".png", deep)).pixels == deep).all()


def test_alpha_is_dropped() -> None:
    rgba = np.dstack([PICTURE[..., ::-1], np.full(PICTURE.shape[:2], 7, np.uint8)])
    ok, data = cv2.imencode(".png", rgba)
    assert ok
    assert (read_image(None, data.tobytes()).pixels == PICTURE).all()


def test_not_a_number_in_a_float_picture_becomes_black() -> None:
    values = np.array([[0.25, np.nan], [np.inf, 2.0]], np.float32)
    assert (read_image(None, encoded(".tiff", values)).pixels == [[0.25, 0], [0, 1]]).all()
    with pytest.raises(InputError, match="no finite pixel"):
        read_image(None, encoded(".tiff", np.full((4, 4), np.nan, np.float32)))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_undone_as_opencv_does(orientation: int) -> None:
    data = with_exif(encoded(".jpg", cv2.resize(PICTURE, (64, 48))), orientation)
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    frame = read_image(None, data)
    assert (frame.pixels == expected).all()
    assert frame.orientation == orientation
    assert frame.focal_35mm == 28


@given(
    st.binary(max_size=200), st.sampled_from([b"", b"II*\0", b"MM\0*", b"\xff\xd8\xff\xe1\0\x40"])
)
def test_damaged_exif_counts_as_absent(data: bytes, start: bytes) -> None:
    assert read_exif(start + data).orientation in range(1, 9)


def bomb() -> bytes:
    data = bytearray(encoded(".png"))
    data[16:24] = struct.pack(">II", 60000, 60000)
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "empty"),
        (b"hello, this is no picture", "not a picture"),
        (b"v/1\x01 more", "standard input is not an EXR file that can be read"),
        (encoded(".jpg")[:-40], "truncated"),
        (encoded(".png")[:-30], "truncated"),
        (bomb(), "60000"),
        (encoded(".png")[:16] + b"\0" * 8 + encoded(".png")[24:], "0×0"),
    ],
    ids=["empty", "text", "exr", "short jpeg", "short png", "bomb", "no pixels"],
)
def test_bad_pictures_are_refused_with_a_reason(data: bytes, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        read_image(None, data)


def test_a_video_is_sent_to_the_command_for_videos() -> None:
    with pytest.raises(InputError, match="'depthcli video' reads videos"):
        read_image(None, b"0000ftypisom", name="clip.mp4")


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("camera.DNG", "is a camera raw file; convert it to JPEG, PNG or TIFF first"),
        ("a.psd", "PNM, EXR); convert it to JPEG, PNG or TIFF first"),
        *(
            (f"a.{suffix}", "PNM, EXR); convert it to EXR or 16-bit TIFF first")
            for suffix in ("dpx", "CIN", "tga", "hdr")
        ),
        ("a.exr", "is not a picture (JPEG, PNG, TIFF, WebP, AVIF, HEIC, BMP, GIF, PNM, EXR)"),
    ],
)
def test_a_picture_of_a_format_that_is_not_read_says_what_to_do(
    name: str, advice: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(b"II*\0" + bytes(100))
    with pytest.raises(InputError, match=re.escape(advice) + "$"):
        read_image(path)


def test_bad_paths_are_refused_with_a_reason(tmp_path: Path) -> None:
    (tmp_path / "broken.png").symlink_to(tmp_path / "nowhere.png")
    (tmp_path / "loop.png").symlink_to(tmp_path / "loop.png")
    for name, reason in [
        ("missing.png", "no such file"),
        (".", "folder"),
        ("broken.png", "broken link"),
        ("loop.png", "cannot be read|broken link"),
    ]:
        with pytest.raises(InputError, match=reason):
            read_image(tmp_path / name)


def test_content_counts_not_the_suffix(tmp_path: Path) -> None:
    path = tmp_path / "picture\nwith a line.txt"
    path.write_bytes(encoded(".png"))
    assert (read_image(path).pixels == PICTURE).all()


def test_one_pixel_is_a_picture() -> None:
    assert read_image(None, encoded(".png", PICTURE[:1, :1])).pixels.shape == (1, 1, 3)


@pytest.mark.parametrize("name", ["a.tif", "A.NEF"])
@pytest.mark.parametrize("tags", [{254: 1, 330: 8}, {254: 0, 330: 8}, {254: 1}, {}])
def test_camera_raw_is_known_by_its_directories_or_its_name(
    name: str, tags: dict[int, int], tmp_path: Path
) -> None:
    pixels = np.full((4, 6, 3), 90, np.uint8)
    path = tmp_path / name
    path.write_bytes(made.tiff(pixels, longs=tags))
    if name == "a.tif" and tags != {254: 1, 330: 8}:
        np.testing.assert_array_equal(read_image(path).pixels, pixels)
        return
    with pytest.raises(InputError, match=r"camera raw files?( do)?; convert it"):
        read_image(path)


def test_an_animated_avif_is_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "a.avif"
    path.write_bytes(encoded(".avif", np.full((16, 16, 3), 90, np.uint8)))
    assert not read_image(path).warnings
    frames = cv2.Animation()
    frames.frames = [np.full((16, 16, 3), level, np.uint8) for level in (40, 90)]
    frames.durations = np.array([100, 100])
    path.write_bytes(cv2.imencodeanimation(".avif", frames)[1].tobytes())
    (warning,) = read_image(path).warnings
    assert "only the first picture is used" in warning


def test_a_side_that_no_decoder_reads_is_named(tmp_path: Path) -> None:
    path = tmp_path / "long.png"
    path.write_bytes(made.png([bytes(1_000_001)], 1_000_001, 8, 0))
    with pytest.raises(InputError, match="no side may be longer than 1,000,000"):
        read_image(path)
    path.write_bytes(made.png([bytes(1_000_000)], 1_000_000, 8, 0))
    assert read_image(path).pixels.shape == (1, 1_000_000)


def test_a_tiff_with_empty_tags_is_an_ordinary_one(tmp_path: Path) -> None:
    data = bytearray(made.tiff(PICTURE, longs={254: 1, 330: 8}))
    path = tmp_path / "a.tif"
    for tag in (254, 330):
        at = data.index(struct.pack("<HHI", tag, 4, 1))
        path.write_bytes(data[: at + 4] + bytes(4) + data[at + 8 :])  # no value
        np.testing.assert_array_equal(read_image(path).pixels, PICTURE)
