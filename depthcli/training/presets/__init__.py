"""Named configurations that ship with the package, as TOML files of this folder."""

from pathlib import Path

from depthcli.errors import UsageError

FOLDER = Path(__file__).parent


def preset_file(name: str) -> Path:
    """The TOML file of a preset.

    Raises:
        UsageError: there is no such preset.
    """
    if name not in preset_names():
        raise UsageError(f"no preset '{name}'; choose from {', '.join(preset_names())}")
    return FOLDER / f"{name}.toml"


def preset_names() -> tuple[str, ...]:
    """Names of the presets, in alphabetic order."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))
