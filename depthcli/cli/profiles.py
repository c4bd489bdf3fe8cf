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
from depthcli.cli.table import PROFILE_COMMANDS, PROGRAM, plain_command
from depthcli.core.options import suggestion
from depthcli.errors import UsageError
from depthcli.io.formats.table import Format, format_of
from depthcli.io.storage.paths import read_regular, user_folder
from depthcli.video.formats import VideoFormat, video_format_of

FILE_NAME = "depthcli.toml"
_MAX_BYTES = 2**20
_NOT_IN_PROFILES = frozenset({"help", "debug", "profile", "out"})


def profile_files() -> tuple[Path, ...]:
    """The files that may hold profiles; the first one that holds a name decides."""
    return Path(FILE_NAME), user_folder("config") / FILE_NAME


def read_profiles(path: Path) -> dict[str, dict[str, Any]]:
    """The profiles of a file by name; none if there is no such file."""
    try:
        tables = tomllib.loads(read_regular(path, _MAX_BYTES).decode("utf-8-sig"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise UsageError(f"{path} is not TOML: {error}") from error
    return tables


def profile_names() -> tuple[str, ...]:
    """Names of all profiles, sorted."""
    return tuple(sorted({name for path in profile_files() for name in read_profiles(path)}))


def apply(context: Any, name: str) -> None:  # noqa: ANN401 - typer's own
    """Set a profile's options as the defaults of the current command."""
    tables = (read_profiles(path).get(name) for path in profile_files())
    values = next((table for table in tables if table is not None), None)
    if values is None:
        there = ", ".join(profile_names()) or f"none in {' and '.join(map(str, profile_files()))}"
        raise UsageError(f"no profile named {name!r}; there are: {there}")
    parameters, defaults = _options_of(context.command), {}
    for key, value in values.items():
        if key in parameters:
            listed = value if isinstance(value, list) or not parameters[key].multiple else [value]
            if parameters[key].name == "formats":  # without those of other commands
                of_any, of_own = {*Format, *VideoFormat}, parameters[key].type.choices
                listed = [word for word in listed if word in of_own or word not in of_any] or None
            defaults[str(parameters[key].name)] = listed
            continue
        names = {key for name in PROFILE_COMMANDS for key in _options_of(plain_command(name))}
        if key not in names:
            hint = suggestion(key, names, f"see '{PROGRAM} {context.info_name} --help'")
            raise UsageError(f"profile {name!r}: no option named {key!r}", hint)
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
        explicit = Given.of(self._context)
        others = {other for names in _EXCLUDING if name in names for other in names} - {name}
        if name == "formats" and "out" in explicit:  # whose name may select the format
            out = str(self._context.params.get("out"))
            others |= {"out"} if format_of(out) or video_format_of(out) else set()
        return super().get(name, default) if others.isdisjoint(explicit) else default


_EXCLUDING = (
    *ALTERNATIVES,
    ("rectified", "cameras", "focal_px", "hfov", "focal_35mm"),
    ("rectified", "centre_px"),
    ("colormap", "near"),
)  #: parameters of which one on the command line overrides the others of a profile


def _options_of(command: Any) -> dict[str, Any]:  # noqa: ANN401 - typer's own types
    """A command's options that a profile may hold, by name without leading dashes."""
    options = [p for p in command.params if p.param_type_name == "option"]
    named = {max(p.opts, key=len).removeprefix("--"): p for p in options}
    return {name: p for name, p in named.items() if name not in _NOT_IN_PROFILES}
