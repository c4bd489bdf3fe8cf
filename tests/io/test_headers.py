"""Readers of headers, for files written here byte by byte as the formats' specifications say."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

import pytest
from helpers import made
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.io.images.decode import find_problem, picture_size
from depthcli.io.images.exif import read_exif
from depthcli.io.images.png import read_text, text_chunk
from depthcli.io.images.tiff import tiff_problem, tiff_tags

if TYPE_CHECKING:
    from collections.abc import Mapping

    Tags = Mapping[int, tuple[int, tuple[int, ...]]]

WIDTH, HEIGHT = 0x1234, 0x2345
FORMS = {1: "B", 3: "H", 4: "I", 8: "h", 9: "i", 13: "I", 16: "Q"}
"""Types of TIFF and BigTIFF that are whole numbers."""
LAYOUTS = [(order, big) for order in "<>" for big in (False, True)]


def tiff(order: str, big: bool, tags: Tags, after: bytes = b"", gap: int = 0) -> bytes:
    """A directory of tags, each with its type and values; what does not fit in lies behind it."""
    number, head = ("Q", 16) if big else ("I", 8)
    inline = struct.calcsize(number)
    mark = struct.pack(order + "2sH", b"II" if order == "<" else b"MM", 43 if big else 42)
    start = head + gap
    data = mark + (
        struct.pack(order + "HHQ", 8, 0, start) if big else struct.pack(order + "I", start)
    )
    behind = start + (8 if big else 2) + (20 if big else 12) * len(tags)
    data += bytes(gap) + struct.pack(order + ("Q" if big else "H"), len(tags))
    outside = b""
    for tag, (kind, values) in sorted(tags.items()):
        text = struct.pack(f"{order}{len(values)}{FORMS.get(kind, 'B')}", *values)
        data += struct.pack(order + "HH" + number, tag, kind, len(values))
        if len(text) > inline:
            data += struct.pack(order + number, behind + len(outside))
            outside += text
        else:
            data += text.ljust(inline, b"\0")
    return data + outside + after


@st.composite
def entries(draw: st.DrawFn) -> tuple[int, tuple[int, ...]]:
    kind = draw(st.sampled_from([*FORMS, 2]))
    bits = 8 * struct.calcsize("<" + FORMS.get(kind, "B"))
    top = (1 << bits - 1) - 1 if FORMS.get(kind, "B").islower() else (1 << bits) - 1
    return kind, tuple(draw(st.lists(st.integers(0, top), max_size=9)))


@settings(max_examples=60)
@given(
    st.sampled_from(LAYOUTS),
    st.dictionaries(st.integers(0, 0xFFFF), entries(), min_size=1, max_size=4),
    st.integers(0, 3),
)
def test_tags_of_every_form_are_found(layout: tuple[str, bool], tags: Tags, gap: int) -> None:
    data = tiff(*layout, tags, gap=gap)
    expected = {tag: values for tag, (kind, values) in tags.items() if kind in FORMS}
    assert dict(tiff_tags(data, tags)) == expected
    one = min(tags)
    assert dict(tiff_tags(data, {one})) == {k: v for k, v in expected.items() if k == one}
    if expected and any(expected.values()):
        with pytest.raises(struct.error):
            list(tiff_tags(data[: 13 + gap], tags))


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("place", [2**32 - 1, 2**63, 2**64 - 1])
def test_numbers_beyond_the_file_are_an_error(layout: tuple[str, bool], place: int) -> None:
    order, big = layout
    form = order + ("Q" if big else "I")
    most = place if big else 2**32 - 1
    data = bytearray(tiff(order, big, {256: (4, (1, 2, 3))}))
    for at, value in ((8 if big else 4, most), (-12 - (16 if big else 8), most)):
        broken = bytearray(data)
        struct.pack_into(form, broken, at % len(data), value)
        with pytest.raises(struct.error):
            list(tiff_tags(bytes(broken), {256}))


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("kind", FORMS)
def test_size_of_a_tiff(layout: tuple[str, bool], kind: int) -> None:
    assert picture_size(tiff(*layout, {256: (kind, (100,)), 257: (kind, (99,))})) == (100, 99)
    assert picture_size(tiff(*layout, {256: (kind, (100,)), 257: (kind, ())})) is None
    assert picture_size(tiff(*layout, {257: (kind, (100,))})) is None


CODINGS = {*range(1, 9), 32773, 32946, 34676, 34677, 34887, 34925, 50000, 50001}
"""None, three of CCITT, LZW, two of JPEG, Deflate, PackBits, old Deflate, two of SGI, LERC, LZMA,
Zstandard, WebP."""


def test_codings_that_libtiff_knows() -> None:
    tried = {0, 65535, *(coding + d for coding in CODINGS for d in (-1, 0, 1))}
    known = {c for c in tried if tiff_problem(tiff("<", False, {259: (3, (c,))})) is None}
    assert known == CODINGS
    assert tiff_problem(tiff("<", False, {})) is None


@pytest.mark.parametrize("parts", [(273, 279), (324, 325)], ids=["strips", "tiles"])
@pytest.mark.parametrize("coding", [1, 8, 32946])
def test_every_part_is_there_and_whole(parts: tuple[int, int], coding: int) -> None:
    whole = [zlib.compress(bytes(range(256)) * 9), zlib.compress(b"other")]

    def data(*pixels: bytes, lost: int = 0) -> bytes:
        def build(at: int) -> bytes:
            offsets = (at, at + len(pixels[0]))
            tags = {259: (3, (coding,)), parts[0]: (4, offsets)}
            return tiff("<", False, tags | {parts[1]: (4, tuple(map(len, pixels)))})

        text = build(len(build(0))) + b"".join(pixels)
        return text[: len(text) - lost]

    damaged = [whole[0], whole[1][:-1] + b"\0"]
    short = [whole[0][:-5], whole[1]]
    for good in (whole, [whole[0] + b"padding", whole[1]]):
        assert tiff_problem(data(*good)) is None
    assert "pixels of the TIFF are missing" in (tiff_problem(data(*whole, lost=1)) or "")
    for bad in (damaged, short):
        found = tiff_problem(data(*bad)) or ""
        assert ("cannot be inflated" in found) is (coding != 1)


SIZED = bytes([8]) + struct.pack(">HH", HEIGHT, WIDTH)
STARTS = sorted({*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC})
BEFORE = {
    "nothing": b"",
    "a long segment": made.segment(0xE2, bytes(0x301)),
    "an empty segment": made.segment(0xFE, b""),
    "fill": b"\xff" * 5,
    "tables": made.segment(0xC4, SIZED[::-1])
    + made.segment(0xCC, SIZED[::-1])
    + made.segment(0xC8, SIZED[::-1]),
    **{f"marker {m:x}": bytes([0xFF, m]) for m in (0x01, *range(0xD0, 0xD8))},
}


@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("start", STARTS)
def test_size_of_a_jpeg(start: int, before: str) -> None:
    data = b"\xff\xd8" + BEFORE[before] + made.segment(start, SIZED + b"\1")
    assert picture_size(data) == (WIDTH, HEIGHT)
    assert picture_size(data[:-5]) is None


@pytest.mark.parametrize("before", BEFORE)
def test_exif_of_a_jpeg(before: str) -> None:
    block = made.exif(6, 28)
    found = made.segment(0xE1, b"Exif\0\0" + block)
    other = made.segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + block)
    other += made.segment(0xE2, b"Exif\0\0" + made.exif(3))
    assert tuple(read_exif(b"\xff\xd8" + BEFORE[before] + other + found)) == (6, 28)
    pixels = made.segment(0xDA, b"")
    assert tuple(read_exif(b"\xff\xd8" + BEFORE[before] + pixels + found)) == (1, None)
    assert tuple(read_exif(b"\xff\xd8" + BEFORE[before] + found[:-1])) in [(6, 28), (6, None)]


def _riff(kind: bytes, body: bytes) -> bytes:
    return b"RIFF" + struct.pack("<I", 12 + len(body)) + b"WEBP" + kind + bytes(4) + body


def _bmp(form: str, length: int, width: int, height: int) -> bytes:
    return b"BM" + bytes(12) + struct.pack("<I" + form, length, width, height)


SIZES = {
    "PNG": (made.png([b"\0"], WIDTH, 8, 0, height=HEIGHT), WIDTH, HEIGHT),
    "GIF 87a": (b"GIF87a" + struct.pack("<HH", WIDTH, HEIGHT), WIDTH, HEIGHT),
    "GIF 89a": (b"GIF89a" + struct.pack("<HH", WIDTH, HEIGHT), WIDTH, HEIGHT),
    "BMP": (_bmp("ii", 40, 70000, 80000), 70000, 80000),
    "BMP from the top": (_bmp("ii", 40, 70000, -80000), 70000, 80000),
    "BMP of OS/2": (_bmp("HH", 12, 40000, 50000), 40000, 50000),
    "WebP": (_riff(b"VP8 ", bytes(6) + struct.pack("<HH", 0x7FFF, 0x8001)), 0x3FFF, 1),
    "lossless WebP": (_riff(b"VP8L", b"\x2f" + struct.pack("<I", 0xF << 28 | 4 << 14 | 6)), 7, 5),
    "largest lossless WebP": (
        _riff(b"VP8L", b"\x2f" + struct.pack("<I", 0xFFFFFFFF)),
        2**14,
        2**14,
    ),
    "extended WebP": (_riff(b"VP8X", bytes(4) + b"\3\2\1\4\5\6\7"), 0x10204, 0x60505),
    "PGM": (b"P5 # a\n#b\n 640\n#c\n480 255\n", 640, 480),
    "PBM": (b"P1\n3 4\n", 3, 4),
    "PPM": (b"P6\t16\r\n9 255\n", 16, 9),
}


@pytest.mark.parametrize("name", SIZES)
def test_size_of(name: str) -> None:
    data, *size = SIZES[name]
    assert picture_size(data) == tuple(size)
    if not name.startswith("P"):
        assert picture_size(data[: 12 if "WebP" in name else 9]) is None


@pytest.mark.parametrize(
    ("focal", "read"), [(28, 28), (3, 3), (1, None), (65535, None), (None, None)]
)
def test_exif_without_an_orientation_is_upright(focal: int | None, read: int | None) -> None:
    inner = tiff("<", False, {0xA405 if focal else 1: (3, (focal or 28,))})
    at = len(tiff("<", False, {0x8769: (4, (0,))})) + 8
    data = tiff("<", False, {0x8769: (4, (at,))}, after=inner)
    assert tuple(read_exif(data)) == (1, read)


@pytest.mark.parametrize(
    "data", [b"RIFF" + bytes(4) + b"WAVE" + bytes(40), b"P7 3 4 ", b"P5 3 x4 "]
)
def test_size_of_no_picture(data: bytes) -> None:
    assert picture_size(data) is None
    assert tuple(read_exif(data)) == (1, None)


def test_exif_of_a_webp_stands_in_any_place() -> None:
    chunks = [(b"XMP ", b"x"), (b"ICCP", b"xx"), (b"EXIF", b"Exif\0\0" + made.exif(8, 50))]
    data = b"RIFF" + bytes(4) + b"WEBP"
    for kind, body in chunks:
        data += kind + struct.pack("<I", len(body)) + body + bytes(len(body) % 2)
    assert tuple(read_exif(data)) == (8, 50)
    assert tuple(read_exif(data[:40])) == (1, None)


def _flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


def test_a_png_is_whole_up_to_its_end() -> None:
    extra = b"".join(text_chunk("key", "value"))
    data = made.png([b"\1\2"], 2, 8, 0, extra)
    first, last = data.index(b"tEXt") - 4, data.index(b"tEXt") - 4 + len(extra)
    end = data.index(b"IEND") - 4
    assert find_problem(data) is None
    assert find_problem(data + b"trailing") is None
    for cut in range(8, len(data)):
        assert "its end is missing" in (find_problem(data[:cut]) or ""), cut
    for at in range(8, end):  # a changed length may lead anywhere
        found = find_problem(_flipped(data, at))
        assert (found is None) is (first + 4 <= at < last), at
    for at in range(end + 8, len(data)):
        assert "checksum" in (find_problem(_flipped(data, at)) or "")


def test_texts_of_a_png() -> None:
    packed = b"packed\0\1\0\0\0" + zlib.compress(b"hidden")
    chunks = [b"".join(text_chunk("a", "é")), b"".join(text_chunk("b", "深")), b"", b""]
    chunks[2] = made.chunk(b"iTXt", b"c\0\0\0en\0translated\0text\0more")
    chunks[3] = made.chunk(b"iTXt", packed) + made.chunk(b"zTXt", b"d\0\0x")
    data = made.png([b"\0"], 1, 8, 0, *chunks)
    assert read_text(data) == {"a": "é", "b": "深", "c": "text\0more"}
    assert read_text(data[: data.index(b"translated")]) == {"a": "é", "b": "深"}
