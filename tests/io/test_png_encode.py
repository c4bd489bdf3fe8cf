"""PNG files: valid, the same pixels, the same bytes, whatever compresses them."""

import sys
import zlib
from io import BytesIO

import cv2
import numpy as np
import pytest
from helpers import made
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image

from depthcli.io.images import png as png_encode
from depthcli.io.images.png import read_chunks, read_text

TYPES = st.sampled_from([np.uint8, np.uint16])
GRAY = array_shapes(min_dims=2, max_dims=2, max_side=12)
SHAPES = st.one_of(GRAY, GRAY.map(lambda shape: (*shape, 3)))
PIXELS = TYPES.flatmap(lambda kind: arrays(kind, SHAPES))


def decoded(png: bytes) -> np.ndarray:
    """The pixels of a file whose chunks and their checksums are those of a PNG."""
    Image.open(BytesIO(png)).verify()
    pixels = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    return pixels if pixels.ndim == 2 else pixels[..., ::-1]


def noise(shape: tuple[int, ...], kind: type) -> np.ndarray:
    return np.random.default_rng(0).integers(0, np.iinfo(kind).max, shape, kind, endpoint=True)


@given(PIXELS)
def test_any_pixels_come_back(pixels: np.ndarray) -> None:
    png = png_encode.encode_png(pixels)
    assert decoded(png).dtype == pixels.dtype
    np.testing.assert_array_equal(decoded(png), pixels)


def test_views_and_foreign_byte_order_come_back() -> None:
    pixels = noise((20, 30, 3), np.uint16)
    for view in (
        pixels[::2, ::-1],
        pixels.transpose(1, 0, 2),
        pixels[..., 1],
        pixels.astype(">u2"),
    ):
        np.testing.assert_array_equal(decoded(png_encode.encode_png(view)), view)


@given(st.dictionaries(st.sampled_from(["a", "depthcli:unit", "é" * 79]), st.text(max_size=40)))
def test_texts_stand_before_the_pixels(texts: dict[str, str]) -> None:
    texts = {keyword: text.replace("\0", "") for keyword, text in texts.items()}
    png = png_encode.encode_png(np.ones((2, 2), np.uint16), texts)
    kinds = [kind for kind, _, _ in read_chunks(png)]
    assert set(kinds[1:-2]) <= {b"tEXt", b"iTXt"}
    assert (len(kinds), kinds[-2:]) == (3 + len(texts), [b"IDAT", b"IEND"])
    assert read_text(png) == texts


def test_without_libdeflate_the_pixels_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    pixels = np.cumsum(noise((60, 80), np.uint8), axis=1).astype(np.uint16)
    usual = png_encode.encode_png(pixels)
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "deflate", None)
        png_encode._compressor.cache_clear()
        png = png_encode.encode_png(pixels)
        assert zlib.compress(png_encode._filtered(pixels), 1) in png
    png_encode._compressor.cache_clear()
    assert png_encode.encode_png(pixels) == usual
    np.testing.assert_array_equal(decoded(png), pixels)


def test_texts_of_other_programs_are_read() -> None:
    packed = made.chunk(b"iTXt", b"packed\0\1\0\0\0" + zlib.compress(b"hidden"))
    translated = made.chunk(b"iTXt", b"c\0\0\0en\0translated\0text\0more")
    latin = b"".join(png_encode.text_chunk("a", "é"))
    data = made.png([b"\0"], 1, 8, 0, latin, translated, packed)
    assert read_text(data) == {"a": "é", "c": "text\0more"}
    assert read_text(data[: data.index(b"translated")]) == {"a": "é"}
