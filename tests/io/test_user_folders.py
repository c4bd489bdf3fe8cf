"""Where a user's own models and profiles lie."""

import sys
from pathlib import Path

import pytest

from depthcli.io.storage.paths import config_folder, data_folder


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)


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
