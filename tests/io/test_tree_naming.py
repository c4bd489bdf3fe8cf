"""Names of outputs in a tree."""

from __future__ import annotations

import unicodedata
from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from depthcli.io.formats.table import FORMATS
from depthcli.jobs.output_names import TreeNames


@pytest.mark.parametrize(
    ("names", "bases"),
    [
        (("a.jpg", "b.png"), ("a", "b")),
        (("hall/a.jpg", "a.jpg"), ("hall/a", "a")),
        (("a.jpg", "a.png"), ("a.jpg", "a.png")),
        (("a.jpg", "a.png", "a.jpg.png"), ("a.jpg", "a.png", "a.jpg.png")),
        (("a.jpg", "a.jpg.png"), ("a", "a.jpg.png")),
        (("a", "a.png"), ("a", "a.png")),
        (("A.jpg", "a.png"), ("A.jpg", "a.png")),
        ((".a.png",), (".a",)),
    ],
)
def test_names(names: tuple[str, ...], bases: tuple[str, ...]) -> None:
    for order in permutations(names):
        assert tuple(TreeNames(order).base(name) for name in names) == bases


def test_names_that_some_file_systems_take_for_one_get_a_checksum() -> None:
    for names in (("A.jpg", "a.jpg"), ("\xe9.png", "e\u0301.png"), ("X/a.png", "x/a.png")):
        bases = [TreeNames(names).base(name) for name in names]
        assert all(base.startswith(f"{name}.") for base, name in zip(bases, names, strict=True))
        assert len({folded(base) for base in bases}) == 2


def folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


_PART = st.sampled_from(["a", "A", "b", "a.jpg", "a.depth", "\udcff", "e\u0301", "\xe9"])
_NAMES = st.sets(
    st.builds(
        "{}{}{}".format,
        st.sampled_from(["", "a/", "A/", "a.jpg/"]),
        _PART,
        st.sampled_from(["", ".jpg", ".png", ".JPG", ".depth.png"]),
    ),
    min_size=1,
)


@given(_NAMES)
def test_no_two_outputs_are_one_file_anywhere(names: set[str]) -> None:
    trees = TreeNames(names)
    outputs = [trees.base(name) + facts.suffix for name in names for facts in FORMATS.values()]
    assert len({folded(output) for output in outputs}) == len(outputs)
