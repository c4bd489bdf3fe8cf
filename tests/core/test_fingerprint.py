"""A checksum of what results follow from."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import pytest

from depthcli.core.options import Upsampling, UpsamplingOptions
from depthcli.core.validation import fingerprint


@dataclass(frozen=True)
class Options:
    """One option."""

    near_m: float | None = None


def test_it_is_the_same_for_ever() -> None:
    facts = (
        "a",
        Options(0.5),
        UpsamplingOptions(tile_px=3),
        Fraction(1, 3),
        Path("a/b"),
        {"b": 1, "a": [2]},
    )
    expected = "8dfdc48b0ec6b653820a5b64f4010be2619f691c85e98ac879adb232e060c5a2"
    assert fingerprint(*facts) == expected


@pytest.mark.parametrize(
    "other",
    [
        Options(1.0),
        Options(),
        None,
        0.5,
        "0.5",
        (Options(0.5),),
        Upsampling.BILINEAR,
        {"near": 0.5},
    ],
)
def test_other_facts_give_another(other: object) -> None:
    assert fingerprint(other) != fingerprint(Options(0.5))


def test_mappings_have_no_order() -> None:
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})


def test_object_without_stable_text_has_no_fingerprint() -> None:
    with pytest.raises(TypeError, match="object has no fingerprint"):
        fingerprint([object()])
