"""Patterns for names, as shells and .gitignore have them."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from depthcli.errors import UsageError
from depthcli.io.listing.folder import (
    EXCLUDED,
    NOT_INCLUDED,
    NameFilter,
)


@pytest.mark.parametrize(
    ("pattern", "name", "matches"),
    [
        ("*.jpg", "a.jpg", True),
        ("*.jpg", "hall/deep/a.jpg", True),
        ("*.jpg", "a.jpg.png", False),
        ("*.jpg", "a.JPG", False),
        ("a.jpg", "ba.jpg", False),
        ("?.png", "a.png", True),
        ("?.png", "ab.png", False),
        ("[ab].png", "b.png", True),
        ("[!ab].png", "b.png", False),
        ("[!ab].png", "c.png", True),
        ("[a-c]*", "hall/box.png", True),
        ("[]].png", "].png", True),
        ("[.png", "[.png", True),
        ("a.png", "axpng", False),
        ("a+(b).png", "a+(b).png", True),
        ("new*line.png", "new\nline.png", True),
        ("hall/*.jpg", "hall/a.jpg", True),
        ("hall/*.jpg", "hall/deep/a.jpg", False),
        ("hall/*.jpg", "deep/hall/a.jpg", False),
        ("hall/**", "hall/deep/a.jpg", True),
        ("hall/**/a.jpg", "hall/a.jpg", True),
        ("hall/**/a.jpg", "hall/x/y/a.jpg", True),
        ("**/a.jpg", "a.jpg", True),
        ("**/a.jpg", "x/y/a.jpg", True),
        ("./hall/a.jpg", "hall/a.jpg", True),
        ("/a.jpg", "a.jpg", True),
        ("/a.jpg", "hall/a.jpg", False),
    ],
)
def test_pattern_matches_names(pattern: str, name: str, matches: bool) -> None:
    assert NameFilter.of([pattern], []).refusal(name) is (None if matches else NOT_INCLUDED)
    assert NameFilter.of([], [pattern]).excludes(name) is matches


@pytest.mark.parametrize(
    ("pattern", "name"),
    [
        ("thumbs", "hall/thumbs/a.jpg"),
        ("thumbs/", "thumbs/deep/a.jpg"),
        ("hall/thumbs", "hall/thumbs/a.jpg"),
        ("t*", "hall/thumbs/a.jpg"),
    ],
)
def test_an_excluded_folder_takes_all_that_is_in_it_along(pattern: str, name: str) -> None:
    assert NameFilter.of(["*.jpg"], [pattern]).refusal(name) == EXCLUDED


def test_an_included_folder_is_no_included_file() -> None:
    assert NameFilter.of(["hall"], []).refusal("hall/a.jpg") == NOT_INCLUDED


@given(st.text(st.characters(exclude_characters="/*?["), min_size=1))
def test_a_name_without_special_characters_matches_itself(name: str) -> None:
    for whole in (name, f"hall/{name}"):
        assert NameFilter.of([name], []).refusal(whole) == (
            NOT_INCLUDED if whole.endswith("/") else None
        )


@given(st.text(), st.text())
def test_no_pattern_is_an_error_of_another_kind(pattern: str, name: str) -> None:
    with suppress(UsageError):
        NameFilter.of([pattern], [pattern]).refusal(name)


@pytest.mark.parametrize("pattern", ["[]", "[z-a]"])
def test_invalid_pattern_is_refused(pattern: str) -> None:
    with pytest.raises(UsageError):
        NameFilter.of([pattern], [])
