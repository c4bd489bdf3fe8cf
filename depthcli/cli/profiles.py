"""Profiles: a table of a TOML file whose options are defaults of a command.

The tables are those of ``depthcli.toml`` in the working directory, then of the same file in the
user's configuration folder.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from depthcli.cli.groups import Given
from depthcli.cli.parse import ALTERNATIVES
from depthcli.cli.table import PROFILE_COMMANDS, PROGRAM, plain_command, suggestion
from depthcli.errors import UsageError
from depthcli.io.formats.table import Format, format_of
from depthcli.io.storage.paths import config_folder, read_regular
from depthcli.video.formats import VideoFormat, video_format_of

FILE_NAME = "depthcli.toml"
_MAX_BYTES = 2**20
_NOT_IN_PROFILES = frozenset({"help", "debug", "profile", "out"})
_FORMAT = "format"


def profile_files() -> tuple[Path, ...]:
    """The files that may hold profiles; the first one that holds a name decides."""
    return Path(FILE_NAME), config_folder() / FILE_NAME


def read_profiles(path: Path) -> dict[str, dict[str, Any]]:
    """The profiles of a file by name; none if there is no such file.

    Raises:
        UsageError: it cannot be read, or is not TOML with a table for each profile.
    """
    try:
        found = tomllib.loads(read_regular(path, _MAX_BYTES).decode())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise UsageError(f"{path} is not TOML: {error}") from error
    if not all(isinstance(table, dict) for table in found.values()):
        raise UsageError(f"{path} has options outside of a table", "begin it with [NAME]")
    return found


def profile_names() -> tuple[str, ...]:
    """Names of all profiles, sorted."""
    return tuple(sorted({name for path in profile_files() for name in read_profiles(path)}))


def apply(context: Any, name: str) -> None:  # noqa: ANN401 - typer's own
    """Set a profile's options as the defaults of the current command.

    Raises:
        UsageError: there is no such profile, or it has an option that no command has.
    """
    tables = (read_profiles(path).get(name) for path in profile_files())
    values = next((table for table in tables if table is not None), None)
    if values is None:
        there = ", ".join(profile_names()) or f"none in {' and '.join(map(str, profile_files()))}"
        raise UsageError(f"no profile named {name!r}; there are: {there}")
    own, defaults = _options_of(context.command), {}
    for key, value in values.items():
        if key in own:
            listed = value if isinstance(value, list) or not own[key].multiple else [value]
            defaults[str(own[key].name)] = _known_formats(own[key], listed)
        elif key not in (known := _all_keys()):
            meant = suggestion(key, known, f"{PROGRAM} {context.info_name}")
            raise UsageError(f"profile {name!r}: no option named {key!r}{meant}")
    context.default_map = _Defaults(context, defaults)


class _Defaults(dict[str, Any]):
    """Defaults by parameter name, left out where the command line gives an alternative.

    Options on the command line are processed first, so they are known when a default is looked up.
    """

    def __init__(self, context: Any, values: dict[str, Any]) -> None:  # noqa: ANN401 - typer's own
        super().__init__(values)
        self._context = context

    def get(self, name: str, default: Any = None) -> Any:  # noqa: ANN401 - as dict has it
        """The default of a parameter that is not on the command line."""
        given = Given.of(self._context)
        others = {other for names in _EXCLUDING if name in names for other in names} - {name}
        if not others.isdisjoint(given) or (name == "formats" and self._names_format(given)):
            return default
        return super().get(name, default)

    def _names_format(self, given: Given) -> bool:
        """Whether the name of the output selects the format."""
        out = str(self._context.params.get("out")) if "out" in given else ""
        return format_of(out) is not None or video_format_of(out) is not None


_EXCLUDING = (
    *ALTERNATIVES,
    ("rectified", "cameras", "focal_px", "hfov"),
    ("rectified", "centre_px"),
    ("colormap", "near"),
)
"""Parameters of which one on the command line overrides the others of a profile."""


def _options_of(command: Any) -> dict[str, Any]:  # noqa: ANN401 - typer's own types
    """A command's options that a profile may hold, by name without leading dashes."""
    options = [p for p in command.params if p.param_type_name == "option"]
    named = {max(p.opts, key=len).removeprefix("--"): p for p in options}
    return {name: p for name, p in named.items() if name not in _NOT_IN_PROFILES}


def _all_keys() -> set[str]:
    """The options of every command that accepts profiles."""
    return {key for name in PROFILE_COMMANDS for key in _options_of(plain_command(name))}


def _known_formats(parameter: Any, value: Any) -> Any:  # noqa: ANN401 - typer's own types
    """A value of a profile; of formats, without those of other commands."""
    if parameter.name != "formats":
        return value
    own, of_any = parameter.type.choices, {*Format, *VideoFormat}
    return [name for name in value if name in own or name not in of_any] or None
