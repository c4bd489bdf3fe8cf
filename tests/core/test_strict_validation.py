"""Foreign values: every type is read as it is stated, and what does not hold is named."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given, settings, strategies as st

from depthcli.core.options import Rule
from depthcli.core.validation import FieldError, parsed_json, validated


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


EVEN = Rule("an even number", lambda number: number % 2 == 0)
RATIO = Rule("a ratio", lambda _: True)


@dataclass(frozen=True, slots=True)
class Inner:
    even: Annotated[int, EVEN] = 2
    share: float = 0.5
    ratio: Annotated[float, RATIO] = 1.0


@dataclass(frozen=True, slots=True)
class Outer:
    name: str
    colour: Colour = Colour.RED
    word: Literal["a", "b"] = "a"
    flag: bool = False
    inner: Inner = field(default_factory=Inner)
    perhaps: Inner | None = None
    numbers: tuple[float, ...] = ()
    counts: Mapping[str, Annotated[int, EVEN]] = field(default_factory=dict)
    score: Annotated[float, Rule("a number", lambda _: True, is_finite=False)] = 0.0
    free: Any = None
    either: int | str = 0


def test_every_type_is_read() -> None:
    values = {
        "name": "x",
        "colour": "blue",
        "word": "b",
        "flag": True,
        "perhaps": None,
        "inner": {"even": 4, "share": 1},
        "numbers": [1, 2.5],
        "counts": {"a": 2},
        "score": math.inf,
        "free": {"a": [1, None, "b", 2**70]},
    }
    nested = Inner(4, 1.0), None, (1.0, 2.5), {"a": 2}, math.inf, values["free"]
    assert validated(Outer, values) == Outer("x", Colour.BLUE, "b", True, *nested)
    assert type(validated(Outer, values).inner.share) is float
    assert validated(Outer, {"name": "x"}) == Outer("x")
    for either in (3, "three", 2**63 - 1, -(2**63)):
        assert validated(Outer, {"name": "x", "either": either}).either == either


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([], "has to be a group of name, colour, word, "),
        ({}, "name is missing"),
        ({"name": 3}, "name has to be text, not 3"),
        ({"colour": "green"}, "colour has to be one of red, blue, not 'green'"),
        ({"word": None}, "word has to be one of a, b, not None"),
        ({"flag": 1}, "flag has to be true or false, not 1"),
        ({"inner": {"even": 3}}, "inner.even has to be an even number, not 3"),
        ({"inner": {"share": math.nan}}, "inner.share has to be a number, not nan"),
        ({"inner": {"ratio": math.inf}}, "inner.ratio has to be a ratio, not inf"),
        ({"inner": {"share": "1"}}, "inner.share has to be a number, not '1'"),
        ({"perhaps": {"odd": 1}}, "perhaps.odd is unknown; choose from even, share, ratio"),
        ({"numbers": "12"}, "numbers has to be a list, not '12'"),
        ({"numbers": [1, "2", "3"]}, "numbers.1 has to be a number, not '2'"),
        *(
            ({"either": wrong}, f"either has to be a whole number, not {wrong}")
            for wrong in (None, 2**63, -(2**63) - 1)
        ),
        ({"counts": {"a": 1, "b": 3}}, "counts.a has to be an even number, not 1"),
        ({"counts": {3: 2}}, "counts has to be an object, not {3: 2}"),
        ({"\x1b[2J": 1}, "'\\x1b[2J' is unknown; choose from name"),
    ],
)
def test_error_names_the_invalid_value(values: Any, message: str) -> None:
    named = {"name": "x", **values} if values else values
    with pytest.raises(FieldError) as caught:
        validated(Outer, named)
    assert str(caught.value).startswith(message)
    assert str(caught.value).isprintable()
    assert "; " not in str(caught.value).removeprefix(message)  # of a list, the first is enough


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, '{"a":' * 100_000, "9" * 5000, b"\xff"])
def test_text_that_is_not_json_is_refused(text: str | bytes) -> None:
    with pytest.raises(FieldError) as caught:
        parsed_json(text)
    assert len(str(caught.value)) < 200


@settings(max_examples=40)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.integers(), inner),
    ),
    st.sampled_from([name for name in Outer.__slots__ if name != "name"]),
)
def test_anything_is_read_or_refused_in_one_line(value: Any, name: str) -> None:
    try:
        validated(Outer, {"name": "x", name: value})
    except FieldError as refused:
        message = str(refused)
    else:
        return
    assert message.startswith(name)
    assert message.isprintable()
    assert len(message) < 400


def test_all_faults_are_in_one_error() -> None:
    fields = {"colour": "green", "inner": {"even": 3, "share": "x"}, "other": 1}
    with pytest.raises(FieldError) as refused:
        validated(Outer, fields)
    named = str(refused.value)
    assert all(
        name in named for name in ("colour ", "inner.even ", "inner.share ", "other ", "name ")
    )
