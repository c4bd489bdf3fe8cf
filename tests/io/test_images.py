"""Images come in at their own precision and upright; bad ones are refused with a reason."""

import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import made
from hypothesis import given, strategies as st
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from PIL.TiffImagePlugin import IFDRational

from depthcli.core.camera import Intrinsics
from depthcli.core.imageops import PANORAMA
from depthcli.core.options import Eye
from depthcli.errors import InputError
from depthcli.io.images.read import read_image
from depthcli.io.images.tiff import EXIF_IFD, parse_exif

IMAGE = np.random.default_rng(0).integers(0, 255, (6, 9, 3), dtype=np.uint8)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_of_a_jpeg_is_undone_as_opencv_does(orientation: int) -> None:
    jpeg = made.encoded(".jpg", cv2.resize(IMAGE, (64, 48)))
    data = made.jpeg_with_exif(jpeg, made.exif(orientation, 28))
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    frame = read_image(None, data)
    assert (frame.pixels == expected).all()
    assert (frame.orientation, frame.focal_35mm) == (orientation, 28)


def test_a_bmp_of_os2_is_read() -> None:
    """Its header has 12 bytes, and sizes of 16 bits."""
    head = struct.pack("<2sIIIIHHHH", b"BM", 26 + 8, 0, 26, 12, 2, 1, 1, 24)
    pixels = read_image(None, head + bytes([3, 2, 1, 6, 5, 4, 0, 0])).pixels
    assert pixels.tolist() == [[[1, 2, 3], [4, 5, 6]]]


@pytest.mark.parametrize(("transfer", "name"), [(16, "PQ"), (18, "HLG"), (13, None)])
def test_high_dynamic_range_of_avif_is_told(transfer: int, name: str | None) -> None:
    data = made.encoded(".avif", IMAGE)
    at = data.index(b"colrnclx") + len(b"colrnclx") + 2
    warnings = read_image(None, data[:at] + transfer.to_bytes(2) + data[at + 2 :]).warnings
    assert [f"({name})" in text for text in warnings] == ([True] if name else [])


def test_not_a_number_in_a_float_image_becomes_black() -> None:
    values = np.array([[0.25, np.nan], [np.inf, 2.0]], np.float32)
    frame = read_image(None, made.encoded(".tiff", values))
    assert (frame.pixels == [[0.25, 0], [0, 1]]).all()
    assert len(frame.warnings) == 1  # about light, which the file does not state
    with pytest.raises(InputError):
        read_image(None, made.encoded(".tiff", np.full((4, 4), np.nan, np.float32)))


@given(
    st.binary(max_size=200), st.sampled_from([b"", b"Exif\0\0II*\0", b"II*\0", b"MM\0*", b"II+\0"])
)
def test_damaged_exif_counts_as_absent(data: bytes, start: bytes) -> None:
    assert parse_exif(start + data).orientation in range(1, 9)


def test_content_counts_not_the_suffix(tmp_path: Path) -> None:
    path = tmp_path / "image\nwith a line.txt"
    path.write_bytes(made.encoded(".png", IMAGE))
    assert (read_image(path).pixels == IMAGE).all()


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
    with pytest.raises(InputError):
        read_image(path)


def test_focal_length_of_a_canon_camera_is_that_of_its_sensor() -> None:
    """Canon states the pixels an inch on the sensor, and no 35-mm equivalent."""
    exif = Image.Exif()
    inner = exif.get_ifd(EXIF_IFD)
    across, down = IFDRational(5_184_000, 904), IFDRational(3_456_000, 603)
    inner |= {0x920A: IFDRational(36), 0xA20E: across, 0xA20F: down, 0xA210: 2}
    inner |= {0xA002: 5184, 0xA003: 3456}
    file = BytesIO()
    Image.fromarray(np.zeros((32, 48, 3), np.uint8)).save(file, "JPEG", exif=exif)
    frame = read_image(None, file.getvalue())
    assert frame.focal_35mm is not None
    focal_px = Intrinsics(focal_35mm=frame.focal_35mm).focal_for(48, 32)
    assert focal_px == pytest.approx(36 / 22.96 * 48, rel=2e-3)
    inner[0xA20E] = IFDRational(5_184_000 * 30, 904)  # as some bodies: a sensor of a millimetre
    Image.fromarray(np.zeros((32, 48, 3), np.uint8)).save(file := BytesIO(), "JPEG", exif=exif)
    frame = read_image(None, file.getvalue())
    assert (frame.focal_35mm, frame.focal_mm) == (None, 36)


@pytest.mark.parametrize(
    "xmp",
    [
        b"<GPano:ProjectionType>equirectangular</GPano:ProjectionType>",
        b"<rdf:Description GPano:ProjectionType='cylindrical'/>",
    ],
)
@pytest.mark.parametrize("kind", ["JPEG", "TIFF", "WEBP", "PNG"])
def test_panorama_by_its_xmp_is_told(xmp: bytes, kind: str) -> None:
    file, options = BytesIO(), {"xmp": xmp}
    if kind == "PNG":
        info = PngInfo()
        info.add_itxt("XML:com.adobe.xmp", xmp.decode())
        options = {"pnginfo": info}
    if kind == "TIFF":
        options = {"tiffinfo": {700: xmp}}
    Image.fromarray(np.zeros((8, 16, 3), np.uint8)).save(file, kind, **options)
    assert read_image(None, file.getvalue()).warnings == (PANORAMA,)


def icc(gamma: float | None) -> bytes:
    """An ICC profile with the tone curve of a gamma, or that of sRGB."""
    curve = b"curv" + struct.pack(">II", 0, 1) + struct.pack(">H", round((gamma or 1) * 256))
    if gamma is None:
        numbers = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
        curve = b"para" + bytes(4) + struct.pack(">HH", 3, 0)
        curve += b"".join(struct.pack(">i", round(number * 65536)) for number in numbers)
    tags = struct.pack(">I4sII", 1, b"gTRC", 144, len(curve))
    head = struct.pack(">I", 144 + len(curve)).ljust(36, b"\0") + b"acsp"
    return head.ljust(128, b"\0") + tags + curve


@pytest.mark.parametrize(
    ("gamma", "is_told"), [(None, False), (2.2, False), (1.8, True), (1.0, True)]
)
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF", "WEBP"])
def test_profile_with_another_tone_curve_is_told(
    gamma: float | None, is_told: bool, kind: str
) -> None:
    """As of ProPhoto (1.8) and of linear TIFF."""
    image = Image.fromarray(np.zeros((8, 16, 3), np.uint8))
    image.save(file := BytesIO(), kind, icc_profile=icc(gamma))
    assert len(read_image(None, file.getvalue()).warnings) == is_told


TOLD = ("has 3 images; only the first is used",)
IMAGES = list(np.random.default_rng(0).integers(0, 255, (3, 40, 60, 3), np.uint8))


def saved(kind: str, count: int, **options: Any) -> bytes:
    first, *others = map(Image.fromarray, IMAGES[:count])
    file = BytesIO()
    first.save(file, kind, save_all=True, append_images=others, **options)
    return file.getvalue()


@pytest.mark.parametrize("options", [{}, {"compression": "tiff_lzw"}, {"big_tiff": True}])
def test_other_pages_of_a_tiff_are_told(options: dict[str, Any]) -> None:
    assert read_image(None, saved("TIFF", 3, **options)).warnings == TOLD
    assert read_image(None, saved("TIFF", 1, **options)).warnings == ()
    ok, data = cv2.imencodemulti(".tiff", IMAGES)
    assert ok
    assert read_image(None, data.tobytes()).warnings == TOLD


def test_thumbnails_and_masks_are_no_other_images() -> None:
    first, *others = map(Image.fromarray, IMAGES)
    for kind, count in ((1, 1), (4, 1), (2, 3)):
        for other in others:
            other.encoderinfo = {"tiffinfo": {254: kind}}
        file = BytesIO()
        first.save(file, "TIFF", save_all=True, append_images=others)
        assert len(read_image(None, file.getvalue()).warnings) == (count > 1)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("GIF", {"duration": 100, "loop": 0}),
        ("PNG", {}),
        ("PNG", {"default_image": True}),
        ("WEBP", {}),
        ("WEBP", {"lossless": True, "exif": b"Exif\0\0II*\0"}),
        ("AVIF", {}),
    ],
)
def test_animation_is_told(kind: str, options: dict[str, Any]) -> None:
    (warning,) = read_image(None, saved(kind, 3, **options)).warnings
    assert "animated" in warning
    assert read_image(None, saved(kind, 1)).warnings == ()


def test_image_for_each_eye_is_told() -> None:
    data = saved("MPO", 2)
    assert read_image(None, data).warnings == ()  # Pillow states no kind
    entries = data.index(b"MPF\0") + 4 + 50
    stereo = data[:entries] + b"\x02\x00\x02\x00" + data[entries + 4 :]
    assert len(read_image(None, stereo).warnings) == 1
    left, right = (read_image(None, stereo, eye=eye) for eye in Eye)
    assert (left.warnings, right.warnings) == ((), ())
    assert (left.pixels == read_image(None, data).pixels).all()
    second = data[data.index(b"\xff\xd8\xff", 4) :]
    assert (right.pixels == read_image(None, second).pixels).all()
    assert (left.pixels != right.pixels).any()
    for other in (data, second, made.encoded(".png", IMAGE)):
        with pytest.raises(InputError):
            read_image(None, other, eye=Eye.RIGHT)
