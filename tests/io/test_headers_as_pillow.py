"""Our readers of sizes and EXIF find what Pillow finds, in whatever a picture is written."""

import io
import warnings
from typing import Any

import pytest
from helpers.made import exif, jpeg_with_exif
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from depthcli.io.images.decode import picture_size
from depthcli.io.images.exif import Exif, read_exif

SIDES = st.integers(1, 300)
_JPEG = st.fixed_dictionaries(
    {
        "progressive": st.booleans(),
        "quality": st.sampled_from([1, 60, 95]),
        "icc_profile": st.sampled_from([None, b"x" * 70_000]),
    }
)
_TIFF = st.fixed_dictionaries(
    {
        "compression": st.sampled_from(["raw", "tiff_lzw", "tiff_adobe_deflate", "packbits"]),
        "big_tiff": st.booleans(),
    }
)
_WEBP = st.fixed_dictionaries(
    {"lossless": st.booleans(), "exact": st.booleans(), "method": st.just(0)}
)
KINDS: dict[str, tuple[list[str], Any]] = {
    "JPEG": (["L", "RGB", "CMYK"], _JPEG),
    "PNG": (["1", "L", "LA", "P", "RGB", "RGBA", "I;16"], st.just({"compress_level": 1})),
    "TIFF": (["1", "L", "RGB", "RGBA", "I;16", "F"], _TIFF),
    "WEBP": (["RGB", "RGBA"], _WEBP),
    "AVIF": (["RGB", "RGBA"], st.just({"speed": 10})),
    "BMP": (["1", "L", "RGB"], st.just({})),
    "GIF": (["L", "P"], st.just({})),
    "PPM": (["1", "L", "RGB"], st.just({})),
}
WITH_EXIF = ("JPEG", "PNG", "TIFF", "WEBP")


@st.composite
def pictures(draw: Any, kind: str) -> bytes:
    modes, options = KINDS[kind]
    size = draw(SIDES), draw(SIDES)
    more = draw(options)
    if kind in WITH_EXIF and draw(st.booleans()):
        more |= {"exif": draw(blocks())}
        more |= {"compression": "raw"} if kind == "TIFF" else {}  # Pillow fails with others
    file = io.BytesIO()
    Image.new(draw(st.sampled_from(modes)), size).save(file, kind, **more)
    return file.getvalue()


@st.composite
def blocks(draw: Any) -> bytes:
    """EXIF as cameras write it, and as none should."""
    made = Image.Exif()
    made.endian = draw(st.sampled_from("<>"))
    if draw(st.booleans()):
        made[0x0112] = draw(st.integers(0, 10))
    if draw(st.booleans()):
        made[0x010F] = draw(st.text(st.characters(codec="ascii"), max_size=40))
    if draw(st.booleans()):
        made.get_ifd(0x8769)[0xA405] = draw(st.integers(0, 2000))
    return made.tobytes()


def pillows(data: bytes) -> tuple[tuple[int, int], Exif]:
    """Size and EXIF by Pillow."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with Image.open(io.BytesIO(data)) as picture:
            facts = picture.getexif()
            orientation, focal = facts.get(0x0112, 1), facts.get_ifd(0x8769).get(0xA405)
            good = orientation if orientation in range(1, 9) else 1
            tags = getattr(picture, "tag_v2", None)  # Pillow turns the size of a TIFF
            size = (tags[256], tags[257]) if tags else picture.size
            return size, Exif(good, float(focal) if focal else None)


@pytest.mark.parametrize("kind", KINDS)
def test_sizes_and_exif_are_those_that_pillow_finds(kind: str) -> None:
    @settings(max_examples=12)
    @given(pictures(kind))
    def check(data: bytes) -> None:
        size, facts = pillows(data)
        assert picture_size(data) == size
        if kind in WITH_EXIF:
            assert read_exif(data) == facts

    check()


def test_exif_behind_fill_bytes_is_found() -> None:
    file = io.BytesIO()
    Image.new("RGB", (8, 8)).save(file, "JPEG")
    data = jpeg_with_exif(file.getvalue(), exif(6, 28))
    assert read_exif(data[:2] + b"\xff" * 5000 + data[2:]) == Exif(6, 28.0)
