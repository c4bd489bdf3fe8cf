"""Hints to install a package name an extra of pyproject.toml."""

import re
import tomllib
from pathlib import Path

import pytest

from depthcli.core import options

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
