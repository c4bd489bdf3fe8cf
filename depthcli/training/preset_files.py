"""Named configurations that ship with the package."""

from __future__ import annotations

from pathlib import Path

from depthcli.errors import UsageError

FOLDER = Path(__file__).parent / "presets"


def preset_file(name: str) -> Path:
    """The file of differences that a preset stands for.

    Raises:
        UsageError: there is no such preset.
    """
    files = {path.stem: path for path in sorted(FOLDER.glob("*.toml"))}
    if name not in files:
        raise UsageError(f"no preset '{name}'; choose from {', '.join(files)}")
    return files[name]
