"""The folders of a user's own models and profiles."""

import os
import sys
from pathlib import Path

from depthcli.errors import OutputError

_PROGRAM = "depthcli"
_NO_HOME = Path(os.path.abspath(os.devnull))  # noqa: PTH100 - Windows has it everywhere
"""Stands for the home of a user without one: it has no files, and none can be written."""


def data_folder() -> Path:
    """Models: ``XDG_DATA_HOME``, else the platform's folder for an application's data."""
    return _base_folder("XDG_DATA_HOME", "LOCALAPPDATA", ".local/share")


def config_folder() -> Path:
    """Profiles: ``XDG_CONFIG_HOME``, else the platform's folder for an application's settings."""
    return _base_folder("XDG_CONFIG_HOME", "APPDATA", ".config")


def _base_folder(variable: str, windows_variable: str, elsewhere: str) -> Path:
    stated = os.environ.get(variable, "")
    if os.path.isabs(stated):  # noqa: PTH117 - the XDG specification has relative ones ignored
        return Path(stated) / _PROGRAM
    home = Path(os.path.expanduser("~"))  # noqa: PTH111 - Path.home() raises where there is none
    if not home.is_absolute():
        home = _NO_HOME
    if sys.platform == "win32":
        base = os.environ.get(windows_variable)
        return (Path(base) if base else home) / _PROGRAM
    if sys.platform == "darwin":
        return home / "Library" / "Application Support" / _PROGRAM
    return home / elsewhere / _PROGRAM


def check_home(path: Path) -> None:
    """Check, before a file is written, that it is not below a missing home folder.

    Raises:
        OutputError: it is.
    """
    if path.is_relative_to(_NO_HOME):
        raise OutputError("there is no home folder to write to; set HOME")
