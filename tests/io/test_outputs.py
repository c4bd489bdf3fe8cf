"""Outputs appear whole or not at all, under names that do not depend on the order."""

import os
import stat
import unicodedata
from collections.abc import Sequence
from itertools import permutations
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from depthcli.errors import OutputError, UsageError
from depthcli.io.formats.table import FORMATS, Format
from depthcli.io.storage.atomic import atomic_path
from depthcli.jobs.outputs import OutputNames, OutputPlan, plan_outputs
from depthcli.jobs.predict import image_destination


def planned(sources: Sequence[Path | None], out: str | None) -> list[OutputPlan[Format]]:
    """Outputs in 16-bit PNG."""
    return plan_outputs(sources, image_destination(out, (Format.PNG16,)))


def test_a_folder_without_a_name_gets_no_outputs() -> None:
    plans = planned([Path(), Path("/"), Path("a.jpg")], None)
    assert [len(plan.outputs) for plan in plans] == [0, 0, 1]


@pytest.mark.parametrize(
    ("sources", "out"),
    [
        ([Path("x/a.jpg"), Path("y/a.jpg")], "out/"),
        ([Path("a.jpg"), Path("b.jpg")], "one.png"),
        ([Path("a.png")], "a.png"),
        ([Path("a.jpg"), Path("a.depth.png")], None),
        ([Path("a.jpg")], "https://host/out/"),
        ([Path("a.jpg"), Path("a.jpg")], "out/"),
        ([Path("a.jpg"), Path.cwd() / "a.jpg"], "out/"),
        ([Path("a.jpg"), Path("x/../a.jpg")], "out/"),
        ([Path("a.png")], os.devnull),
    ],
    ids=[
        *("same name", "one file for two", "input", "input of another", "behind HTTP"),
        *("twice", "twice, in full", "twice, by another way", "beside a device"),
    ],
)
def test_shared_outputs_and_inputs_are_refused(sources: list[Path], out: str | None) -> None:
    with pytest.raises(UsageError):
        planned(sources, out)


@pytest.mark.parametrize("name", ["..png", "...png", ".png", "a..png"])
def test_dots_in_a_name_lead_to_no_other_folder(name: str) -> None:
    (plan,) = planned([Path("in") / name], "out/")
    assert [path.parent for path in plan.outputs.values()] == [Path("out")]


def test_devices_and_pipes_are_not_replaced(tmp_path: Path) -> None:
    pipe, link = tmp_path / "pipe.png", tmp_path / "link.png"
    os.mkfifo(pipe)
    link.symlink_to(os.devnull)
    for path in (pipe, link, Path(os.devnull), Path("/dev/stdout")):
        with pytest.raises(OutputError), atomic_path(path):
            pytest.fail("nothing is written")
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert link.is_symlink()
    assert sorted(tmp_path.iterdir()) == [link, pipe]


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
        assert tuple(OutputNames(order).base(name) for name in names) == bases


def test_names_that_some_file_systems_take_for_one_get_a_checksum() -> None:
    for alike in (("A.jpg", "a.jpg"), ("\xe9.png", "e\u0301.png"), ("X/a.png", "x/a.png")):
        bases = [OutputNames(alike).base(name) for name in alike]
        assert all(base.startswith(f"{name}.") for base, name in zip(bases, alike, strict=True))
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
    trees = OutputNames(names)
    outputs = [trees.base(name) + facts.suffix for name in names for facts in FORMATS.values()]
    assert len({folded(output) for output in outputs}) == len(outputs)
