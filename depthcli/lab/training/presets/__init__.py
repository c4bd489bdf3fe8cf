"""Named configurations that ship with the package, as TOML files of this folder."""

from pathlib import Path

from depthcli.errors import UsageError

FOLDER = Path(__file__).parent
PRESETS = {  #: the method that each preset is for; "" for all of them
    "paper": "",
    "paper-small": "",
    "reduced": "",
    "bundled": "proposed",
    "finetune": "proposed",
}


def preset_file(name: str, method: str | None = None) -> Path:
    """The TOML file of a preset."""
    if name not in PRESETS:
        raise UsageError(f"no preset '{name}'; choose from {', '.join(PRESETS)}")
    if method and PRESETS[name] not in ("", method):
        raise UsageError(f"the preset {name} is for the method {PRESETS[name]}, not {method}")
    return FOLDER / f"{name}.toml"
