"""Where a user's own models and profiles lie; without a home nothing is written anywhere."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest

from depthcli.io.storage.paths import config_folder, data_folder

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)


def test_without_a_home_nothing_is_there_and_nothing_is_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pwd = pytest.importorskip("pwd")

    def unknown(_user: int) -> None:
        raise KeyError

    monkeypatch.setattr(pwd, "getpwuid", unknown)  # as in a container with a number for a user
    for folder in (config_folder(), data_folder()):
        assert folder.is_absolute()
        assert not folder.exists()
        with pytest.raises(OSError, match="Not a directory"):
            folder.mkdir(parents=True)


def test_a_home_that_is_there_is_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert config_folder().is_relative_to(tmp_path)


@pytest.mark.parametrize(
    ("platform", "variables", "data", "config"),
    [
        ("linux", {}, "~/.local/share/depthcli", "~/.config/depthcli"),
        ("linux", {"XDG_DATA_HOME": "/d"}, "/d/depthcli", "~/.config/depthcli"),
        ("linux", {"XDG_CONFIG_HOME": "c"}, "~/.local/share/depthcli", "~/.config/depthcli"),
        ("darwin", {}, *["~/Library/Application Support/depthcli"] * 2),
        ("win32", {"LOCALAPPDATA": "/l", "APPDATA": "/a"}, "/l/depthcli", "/a/depthcli"),
        ("win32", {}, "~/depthcli", "~/depthcli"),
    ],
)
def test_each_platform_has_its_folders(
    platform: str,
    variables: dict[str, str],
    data: str,
    config: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    for name in ("LOCALAPPDATA", "APPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"HOME": str(tmp_path), **variables}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "platform", platform)
    found = [str(folder()).replace(str(tmp_path), "~") for folder in (data_folder, config_folder)]
    assert found == [data, config]
