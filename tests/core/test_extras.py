"""What hints tell people to install is what pyproject.toml lists."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from depthcli.core import options as extras

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("extra", ["train", "tensorboard", "heif"])
def test_a_hint_names_each_package_of_the_extra(extra: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    listed = [re.split(r"[<>=;\[]", line)[0] for line in project["optional-dependencies"][extra]]
    command = getattr(extras, f"INSTALL_{extra.upper()}")
    assert command.split()[:2] == ["pip", "install"]
    assert command.split()[2:] == [name for name in listed if name != "depthcli"]


def test_no_hint_needs_an_index_that_has_depthcli() -> None:
    texts = [*ROOT.glob("depthcli/**/*.py"), *ROOT.glob("docs/*.md"), ROOT / "README.md"]
    named = [str(path) for path in texts if "install 'depthcli[" in path.read_text("utf-8")]
    assert named == []
