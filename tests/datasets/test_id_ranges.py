from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from depthcli.datasets import base as id_ranges


@given(st.sets(st.integers(0, 1448)))
def test_what_was_written_is_read(numbers: set[int]) -> None:
    ids = [f"{number:04d}" for number in numbers]
    assert id_ranges.parse(id_ranges.compact(ids)) == numbers


def test_neighbours_are_one_range() -> None:
    assert id_ranges.compact(["0007", "0001", "0002", "0000"]) == "0000-0002,0007"
