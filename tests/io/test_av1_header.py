"""The size in the sequence header of AV1, whatever else the header has."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.io.images.decode import picture_size
from depthcli.io.images.isobmff import avif_size


class Bits:
    """Writes numbers of so many bits; what is not read has any value."""

    def __init__(self, draw: st.DrawFn) -> None:
        self._draw, self.text = draw, ""

    def put(self, count: int, value: int | None = None) -> int:
        if not count:
            return 0
        if value is None:
            value = self._draw(st.integers(0, (1 << count) - 1))
        self.text += format(value, f"0{count}b")
        return value

    def put_operating_points(self) -> None:
        delay_bits = 0
        if self.put(1):  # timing_info_present_flag
            self.put(64)  # num_units_in_display_tick, time_scale
            if self.put(1):  # equal_picture_interval
                zeros = self._draw(st.integers(0, 5))  # num_ticks_per_picture_minus_1
                self.put(zeros + 1, 1)
                if zeros:
                    self.put(zeros)
            if self.put(1):  # decoder_model_info_present_flag
                delay_bits = self.put(5) + 1
                self.put(42)
        displayed = self.put(1)  # initial_display_delay_present_flag
        for _ in range(self.put(5, self._draw(st.integers(0, 3))) + 1):
            self.put(12)  # operating_point_idc
            if self.put(5, self._draw(st.sampled_from([0, 7, 8, 31]))) > 7:  # seq_level_idx
                self.put(1)
            if delay_bits and self.put(1):
                self.put(2 * delay_bits + 1)
            if displayed and self.put(1):
                self.put(4)


@st.composite
def headers(draw: st.DrawFn) -> tuple[bytes, tuple[int, int]]:
    """A sequence header as section 5.5 of the AV1 specification has it, and its size."""
    bits = Bits(draw)
    bits.put(4)  # seq_profile, still_picture
    if bits.put(1):  # reduced_still_picture_header
        bits.put(5)
    else:
        bits.put_operating_points()
    lengths = draw(st.integers(1, 16)), draw(st.integers(1, 16))
    for length in lengths:
        bits.put(4, length - 1)
    size = tuple(bits.put(length) + 1 for length in lengths)
    bits.put(8 * draw(st.integers(0, 1)))  # what comes after the size
    text = bits.text + "0" * (-len(bits.text) % 8)
    return int(text, 2).to_bytes(len(text) // 8, "big"), (size[0], size[1])


def leb128(value: int, length: int) -> bytes:
    """A number in so many bytes, of which the last may say nothing."""
    parts = [value >> 7 * i & 0x7F | 0x80 for i in range(length)]
    return bytes([*parts[:-1], parts[-1] & 0x7F])


@st.composite
def units(draw: st.DrawFn) -> tuple[bytes, tuple[int, int]]:
    """A sequence header and what may stand before it, and its size."""
    header, size = draw(headers())
    kinds = draw(st.lists(st.sampled_from([2, 3, 4, 5, 6, 15]), max_size=2))
    data = b""
    for kind, content in (*((kind, b"\x0a" * 200) for kind in kinds), (1, header)):
        longer = draw(st.booleans())
        data += bytes([kind << 3 | longer << 2 | 2, *[0xFF] * longer])
        data += leb128(len(content), draw(st.integers(len(content) // 128 + 1, 8))) + content
    return data, size


def box(kind: bytes, content: bytes = b"") -> bytes:
    return struct.pack(">I4s", 8 + len(content), kind) + content


CLAIM = box(b"iprp", box(b"ipco", box(b"ispe", struct.pack(">III", 0, 1, 1))))
START = box(b"ftyp", b"avif" + bytes(4)) + box(b"free")


@st.composite
def files(draw: st.DrawFn, version: int, index: int) -> tuple[bytes, tuple[int, int]]:
    """Items as section 8.11.3 of ISO/IEC 14496-12 has them, and the largest of their sizes."""
    wide = 4 if version == 2 else 2
    widths = [draw(st.sampled_from(some)) for some in ([4, 8], [0, 4, 8], [0, 4, 8])]
    offset, length, base = widths
    items, stores, sizes = [], {0: b"", 1: b""}, []
    for _ in range(draw(st.integers(1, 3))):
        data, size = draw(units())
        sizes.append(size)
        method, extents = draw(st.integers(0, 1)) if version else 0, []
        places = st.sets(st.integers(1, len(data) - 1), max_size=2 if length else 0)
        for first, last in pairwise([0, *sorted(draw(places)), len(data)]):
            stores[method] += bytes(draw(st.integers(0, 2)))
            extents.append((len(stores[method]), last - first))
            stores[method] += data[first:last]
        stores[method] += bytes(1)  # where there are no lengths, an item ends with the file
        items.append((method, extents))

    def whole(mdat: int) -> bytes:
        def number(size: int, value: int) -> bytes:
            return value.to_bytes(size, "big") if size else b""

        text = bytes([version, 1, 2, 3, offset << 4 | length, base << 4 | index])
        text += number(wide, len(items))
        for method, extents in items:
            text += number(wide, 7) + (number(2, 0xFF0 | method) if version else b"") + bytes(2)
            first = extents[0][0] + (0 if method else mdat)
            text += number(base, first) + number(2, len(extents))
            for at, count in extents:
                place = at + (0 if method else mdat) - (first if base else 0)
                text += number(index if version else 0, 1) + number(offset, place)
                text += number(length, count)
        meta = box(b"free") + box(b"iloc", text) + box(b"idat", stores[1]) + CLAIM
        before = START + box(b"meta", bytes(4) + meta)
        return before + box(b"mdat", stores[0])

    data = whole(len(whole(0)) - len(stores[0]))
    return data, max([(1, 1), *sizes], key=lambda size: size[0] * size[1])


@pytest.mark.parametrize("version", [0, 1, 2])
@pytest.mark.parametrize("index", [0, 4, 8])
def test_the_largest_picture_is_found_wherever_its_item_lies(version: int, index: int) -> None:
    @settings(max_examples=8)
    @given(files(version, index))
    def check(made: tuple[bytes, tuple[int, int]]) -> None:
        data, size = made
        width, height = avif_size(data) or (0, 0)
        assert width * height == size[0] * size[1]

    check()


@settings(max_examples=50)
@given(units(), st.integers(0, 2), st.integers(0, 5))
def test_the_first_chunk_of_an_animation_counts(
    made: tuple[bytes, tuple[int, int]], empty: int, gap: int
) -> None:
    data, size = made
    none = box(b"stco", bytes(8))
    head = START + box(b"moov", none * empty + box(b"stco", bytes(4 + 4 + 8))) + CLAIM
    at = len(head) + 8 + gap
    chunk = box(b"stco", struct.pack(">IIII", 0, 2, at, 0))
    whole = head.replace(box(b"stco", bytes(16)), chunk) + box(b"mdat", bytes(gap) + data)
    assert avif_size(whole) == max((1, 1), size, key=lambda size: size[0] * size[1])


def test_a_list_of_items_that_is_cut_short_or_uses_bytes_too_often_is_refused() -> None:
    end = box(b"mdat")

    def whole(items: int, cut: int) -> bytes:
        """Items that are the whole file each."""
        text = bytes([0, 0, 0, 0, 0x44, 0]) + struct.pack(">H", items)
        text += struct.pack(">HHHII", 1, 0, 1, 0, 0) * items
        return START + box(b"meta", bytes(4) + box(b"iloc", text[: len(text) - cut]) + CLAIM) + end

    assert picture_size(whole(4, 0)) == (1, 1)
    assert picture_size(whole(5, 0)) is None
    assert not any(picture_size(whole(2, cut)) for cut in range(1, 36))


def test_a_part_without_a_length_is_also_taken_for_an_empty_one() -> None:
    content = (
        b"\x0a\x00\x03\x08\x00\x10\x00"  # a picture of 1 x 2, and a byte within that is not its
    )

    def whole(mdat: int) -> bytes:
        parts = ((mdat, 1), (mdat + 1, 0), (mdat + 2, 4))
        text = bytes([0, 0, 0, 0, 0x44, 0]) + struct.pack(">HHHH", 1, 1, 0, len(parts))
        text += b"".join(struct.pack(">II", *part) for part in parts)
        return START + box(b"meta", bytes(4) + box(b"iloc", text) + CLAIM) + box(b"mdat", content)

    assert avif_size(whole(len(whole(0)) - len(content))) == (1, 2)


def test_the_largest_claim_has_the_most_pixels() -> None:
    claims = (b"ispe" + struct.pack(">III", 0, *size) for size in ((20, 4), (10, 10), (4, 20)))
    assert avif_size(b"".join(claims) + b"mdat") == (10, 10)
