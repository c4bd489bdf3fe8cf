"""The size in the sequence header of AV1, whatever else the header has."""

from __future__ import annotations

import struct

from hypothesis import given
from hypothesis import strategies as st

from depthcli.io.pictures.avif import _coded_sizes, avif_size


class Bits:
    """Writes numbers of so many bits; what is not read has any value."""

    def __init__(self, draw: st.DrawFn) -> None:
        self._draw, self.text = draw, ""

    def put(self, count: int, value: int | None = None) -> int:
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
            if self.put(5) > 7:  # seq_level_idx
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
    bits.put(8)
    text = bits.text + "0" * (-len(bits.text) % 8)
    return int(text, 2).to_bytes(len(text) // 8, "big"), (size[0], size[1])


@given(headers(), st.booleans())
def test_the_size_of_any_header_is_found(made: tuple[bytes, tuple[int, int]], longer: bool) -> None:
    header, size = made
    obu = bytes([1 << 3 | longer << 2 | 2, *[0] * longer, len(header)]) + header
    other = bytes([2 << 3 | 2, 3]) + b"abc"  # a temporal delimiter or the like goes before
    assert _coded_sizes(memoryview(other + obu)) == [size]


def test_the_largest_claim_has_the_most_pixels() -> None:
    claims = (b"ispe" + struct.pack(">III", 0, *size) for size in ((20, 4), (10, 10), (4, 20)))
    assert avif_size(b"".join(claims) + b"mdat") == (10, 10)
