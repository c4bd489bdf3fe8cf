"""HEIC images: bits, channels, how they were held, several in one; what is refused."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import made
from helpers.bad_images import HEIGHT, WIDTH, reason
from helpers.heifs import heic, pillow_heif

from depthcli.errors import InputError
from depthcli.io.images.heif import is_heif
from depthcli.io.images.read import check, read_image
from depthcli.io.listing import Skipped, conversion_hint
from depthcli.io.media import is_image

_ROWS, _COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
IMAGE = np.dstack([_COLUMNS * 2, _ROWS * 3, 255 - _COLUMNS * 2]).astype(np.uint8)
DEEP = IMAGE.astype(np.uint16) * 257
FILES = {
    "colour": heic(IMAGE),
    "tiles": heic(IMAGE, tile_size=64),
    "alpha": heic(np.dstack([IMAGE, np.full_like(IMAGE[..., :1], 255)])),
    "gray": heic(IMAGE[..., 1]),
    "deep": heic(DEEP),
    "of a camera": heic(IMAGE, exif=made.exif(6, focal_35mm=26)),
}


def distance(pixels: npt.NDArray[Any], expected: npt.NDArray[Any]) -> float:
    """The mean difference, in levels of the pixels' type."""
    assert (pixels.shape, pixels.dtype) == (expected.shape, expected.dtype)
    return float(abs(pixels.astype(float) - expected).mean())


@pytest.mark.parametrize("name", ["colour", "tiles", "alpha"])
def test_colours_are_those_of_the_image(name: str) -> None:
    pixels = read_image(None, FILES[name]).pixels
    assert distance(pixels, IMAGE) < 2
    pixels[0] = 0  # it is the caller's own


def test_gray_stays_gray() -> None:
    assert distance(read_image(None, FILES["gray"]).pixels, IMAGE[..., 1]) < 2


@pytest.mark.parametrize("bits", [10, 12])
@pytest.mark.parametrize("white_level", [None, 4095])
def test_more_than_8_bits_become_16(bits: int, white_level: int | None) -> None:
    ramp = np.linspace(0, 65535, WIDTH).astype(np.uint16)
    deep = np.repeat(np.repeat(ramp[None, :, None], HEIGHT, 0), 3, 2)
    data = heic(deep, bit_depth=bits, quality=-1)
    assert pillow_heif.open_heif(data).info["bit_depth"] == bits
    pixels = read_image(None, data, white_level=white_level).pixels
    assert distance(pixels, deep) < 65535 / 2**bits
    assert pixels.max() == 65535
    assert len(np.unique(pixels)) > 90
    gray = read_image(None, heic(deep[..., 0], bit_depth=bits)).pixels
    assert distance(gray, deep[..., 0]) < 300


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_turned_image_is_turned_once(orientation: int) -> None:
    """The file has the orientation in its properties, which count, and in its EXIF."""
    stored = np.ascontiguousarray(made.upright_to_stored(IMAGE, orientation))
    data = heic(stored, exif=made.exif(orientation, focal_35mm=26))
    assert pillow_heif.open_heif(data).info["exif"] == made.exif(orientation, focal_35mm=26)
    frame = read_image(None, data)
    assert distance(frame.pixels, IMAGE) < 2
    assert (frame.orientation, frame.focal_35mm) == (orientation, 26)


def test_the_orientation_in_exif_alone_does_not_count() -> None:
    data = heic(IMAGE, exif=made.exif(1, focal_35mm=26))
    assert made.exif(1, focal_35mm=26) in data
    frame = read_image(None, data.replace(made.exif(1, 26), made.exif(6, 26)))
    assert distance(frame.pixels, IMAGE) < 2
    assert (frame.orientation, frame.focal_35mm) == (1, 26)


def test_exif_behind_its_usual_head_is_found() -> None:
    frame = read_image(None, heic(IMAGE, exif=b"Exif\0\0" + made.exif(1, focal_35mm=26)))
    assert frame.focal_35mm == 26
    assert read_image(None, FILES["colour"]).focal_35mm is None


def test_of_several_images_the_primary_one_is_used() -> None:
    frame = read_image(None, heic(DEEP, IMAGE[:32, :40], primary_index=1))
    assert distance(frame.pixels, IMAGE[:32, :40]) < 2
    assert frame.warnings == ("has 2 images; only the primary one is used",)


@pytest.mark.parametrize(("transfer", "name"), [(16, "PQ"), (18, "HLG")])
def test_high_dynamic_range_is_told(transfer: int, name: str) -> None:
    (warning,) = read_image(None, heic(DEEP, transfer_characteristics=transfer)).warnings
    assert f"({name})" in warning
    assert warning.endswith("sRGB first")


def test_content_counts_and_avif_is_not_heif() -> None:
    heif = heic(IMAGE, chroma=420)
    assert heif[8:12] == b"heic"
    assert is_heif(heif)
    for brand in (b"heix", b"hevc", b"mif1"):  # the last one is in the list as well
        assert is_heif(heif[:8] + brand + heif[12:])
    assert not is_heif(heif.replace(b"miaf", b"avif"))
    assert not is_heif(heif.replace(b"ftyp", b"free"))
    assert not is_heif(b"\0\0\0\x14ftypisom\0\0\0\0mp42")


@pytest.mark.parametrize("name", FILES)
def test_the_size_is_known_before_anything_is_decoded(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert read_image(None, FILES[name], max_pixels=WIDTH * HEIGHT).width in (WIDTH, HEIGHT)

    def never(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr(pillow_heif.HeifImage, "__array_interface__", property(never))
    assert reason(FILES[name], max_pixels=WIDTH * HEIGHT - 1)


@pytest.mark.parametrize("name", FILES)
def test_every_truncated_file_is_refused(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    data = FILES[name]
    for length in {*range(0, len(data), 7), *range(len(data) - 30, len(data))}:
        assert reason(data[:length])
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("without_heif")
def test_without_pillow_heif_one_line_says_what_to_install() -> None:
    expected = "a.heic is HEIC, which needs pillow-heif; pip install 'depthcli[heif]'"
    for read in (check, lambda data, name: read_image(None, data, name=name)):
        with pytest.raises(InputError) as caught:
            read(FILES["colour"], "a.heic")
        assert str(caught.value) == expected


NAMES = ("a.heic", "A.HEIC", "a.heif", "a.HIF")


def test_names_of_heif_are_those_of_images() -> None:
    assert all(map(is_image, NAMES))
    assert not is_image("heic")


@pytest.mark.usefixtures("without_heif")
def test_without_pillow_heif_they_are_skipped_with_advice() -> None:
    assert not any(map(is_image, NAMES))
    hint = conversion_hint([Skipped("a.heic", ".heic"), Skipped("b.dng", ".dng")])
    assert (hint or "").endswith("'depthcli[heif]'")
