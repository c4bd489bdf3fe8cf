"""Choices are plain words, hints name extras, and fingerprints are of what results follow from."""

import re
import tomllib
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import pytest

from depthcli.core import options
from depthcli.core.options import AUTO_TILE, Upsampling, UpsamplingOptions, check_pixel_count
from depthcli.core.validation import fingerprint
from depthcli.errors import InputError, UsageError


def test_as_many_pixels_as_allowed_pass() -> None:
    check_pixel_count("a.png", 10, 10, 100)
    with pytest.raises(InputError) as refused:
        check_pixel_count("a.png", 101, 1, 100)
    assert "101×1" in refused.value.message.problem
    assert "{max_pixels}" in refused.value.message.advice


def test_choices_are_taken_as_plain_words_too() -> None:
    assert UpsamplingOptions(upsampling="bilinear").upsampling is Upsampling.BILINEAR  # type: ignore[arg-type]


def test_tiles_of_a_negative_width_are_refused() -> None:
    assert UpsamplingOptions(tile_px=AUTO_TILE).tile_px == AUTO_TILE == 0
    with pytest.raises(UsageError):
        UpsamplingOptions(tile_px=-1)


ROOT = Path(__file__).parents[2]
HINTS = sorted(name for name in vars(options) if name.startswith("INSTALL_"))


@pytest.mark.parametrize("name", HINTS)
def test_hint_names_an_extra_or_one_package_of_an_extra(name: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    packages = {re.split(r"[<>=;\[]", line)[0] for lines in extras.values() for line in lines}
    what = getattr(options, name).removeprefix("pip install ")
    assert what in {f"'.[{extra}]'" for extra in extras} | packages


def test_no_hint_needs_an_index_that_has_depthcli() -> None:
    texts = [*ROOT.glob("depthcli/**/*.py"), *ROOT.glob("docs/*.md"), ROOT / "README.md"]
    named = [str(path) for path in texts if "install 'depthcli[" in path.read_text("utf-8")]
    assert named == []


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
        *(Options(1.0), Options(), (Options(0.5),)),
        *(None, 0.5, "0.5", Upsampling.BILINEAR, {"near": 0.5}),
    ],
)
def test_other_facts_give_another(other: object) -> None:
    assert fingerprint(other) != fingerprint(Options(0.5))


def test_mappings_have_no_order() -> None:
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})


def test_object_without_stable_text_has_no_fingerprint() -> None:
    with pytest.raises(TypeError, match="object has no fingerprint"):
        fingerprint([object()])
