"""``depthcli profile``: options saved under a name."""

import copy
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import typer

from depthcli.cli import completion, profile_files
from depthcli.cli.checks import is_given
from depthcli.cli.options import JsonOutputOption
from depthcli.cli.profile_files import Scalar, Value
from depthcli.cli.screen import console
from depthcli.core.text import one_line
from depthcli.errors import ExitCode, UsageError

app = typer.Typer(
    rich_markup_mode=None,
    invoke_without_command=True,
    help="Save options under a name, for --profile.",
)

_PATHS = ("anchors", "calibration", "cameras")
_META_KEY = "depthcli.profile"
_Name = Annotated[
    str, typer.Argument(metavar="NAME", autocompletion=completion.profiles, help="Profile name.")
]


@app.callback()
def _profile_group(context: typer.Context) -> None:
    """Options saved under a name; without a command, their list."""
    if context.invoked_subcommand is None:
        list_profiles()


@app.command()
def save(
    context: typer.Context,
    name: _Name,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an existing profile of this name.")
    ] = False,
) -> int:
    """Save options under a name.

    Takes the options of predict, batch and video, such as --hfov 81 --png-scale 256.
    """
    values: dict[str, Value] = context.meta.get(_META_KEY, {})
    if not values:
        raise UsageError("give the options to save, such as --hfov 81 --png-scale 256")
    from depthcli.cli.profiles import check_together

    check_together(values)
    path = profile_files.write_profile(name, values, force=force)
    console.report(f"saved {one_line(str(path))}")
    return ExitCode.OK


@app.command("list")
def list_profiles(as_json: JsonOutputOption = False) -> int:
    """List the profiles."""
    names = profile_files.profile_names()
    if not names and not as_json:
        console.note("no profile is saved yet; 'depthcli profile save NAME' with options saves one")
    code = ExitCode.OK
    for name in names:
        try:
            values = profile_files.read_profile(name)
        except UsageError as error:
            console.error(str(error))
            code = ExitCode.SOME_FAILED
            continue
        if as_json:
            path = str(profile_files.profile_path(name))
            console.out_json({"name": name, "path": path, "options": values})
        else:
            options = profile_files.profile_text(name).strip().replace("\n", "; ")
            console.out(one_line(f"{name}: {options}"))
    return code


@app.command("show")
def show_profile(name: _Name) -> int:
    """Show a profile, as TOML."""
    for line in profile_files.profile_text(name).splitlines():
        console.out(one_line(line))
    return ExitCode.OK


@app.command("remove")
def remove_profiles(
    profiles: Annotated[
        list[str],
        typer.Argument(
            metavar="NAME...", autocompletion=completion.profiles, help="Profile names."
        ),
    ],
) -> int:
    """Delete profiles."""
    for name in profiles:
        profile_files.profile_text(name)  # raises before any is removed
    for name in dict.fromkeys(profiles):
        console.report(f"removed {one_line(str(profile_files.remove_profile(name)))}")
    return ExitCode.OK


def add_options(group: Any) -> None:  # noqa: ANN401 - typer's own types
    """Add the options of every command that accepts profiles to ``save``."""
    from depthcli.cli.profiles import options_of, profiled_commands

    command = group.commands["save"]
    known = {word for parameter in command.params for word in parameter.opts}
    found: dict[str, list[Any]] = {}
    for profiled in profiled_commands():
        for key, parameter in options_of(profiled).items():
            found.setdefault(key, []).append(parameter)
    for key, variants in found.items():
        if known.isdisjoint(variants[0].opts):
            command.params.append(_recording_option(key, variants))
            known.update(variants[0].opts)


class _AnyType:
    """The type of an option whose choices differ between commands: accepts those of any."""

    def __init__(self, variants: list[Any]) -> None:
        self._types = [parameter.type for parameter in variants]

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - an attribute of the first type
        return getattr(self._types[0], name)

    def __call__(self, value: Any, **place: Any) -> Any:  # noqa: ANN401 - as typer's types have it
        for kind in self._types[1:]:
            try:
                return kind(value, **place)
            except Exception as error:  # noqa: BLE001 - typer's own; the first type's counts
                del error
        return self._types[0](value, **place)


def _recording_option(key: str, variants: list[Any]) -> Any:  # noqa: ANN401 - typer's own types
    """A copy of an option that records its value if it is given."""
    option, check = copy.copy(variants[0]), variants[0].callback
    option.type = _AnyType(variants)

    def record(context: Any, used: Any, value: Any) -> Any:  # noqa: ANN401 - typer's own types
        value = check(context, used, value) if check else value
        if is_given(context, used.name):
            context.meta.setdefault(_META_KEY, {})[key] = _toml_value(key, value)
        return value

    option.callback, option.expose_value, option.required = record, False, False
    return option


def _toml_value(key: str, value: Any) -> Value:  # noqa: ANN401 - any option value
    if isinstance(value, list | tuple):
        return [_toml_scalar(part) for part in value]
    word = _toml_scalar(value)
    is_path = key in _PATHS or (key == "model" and not _is_catalog_name(str(word)))
    if is_path and Path(str(word)).exists():
        return str(Path(str(word)).resolve())  # so that it works from every folder
    return word


def _is_catalog_name(word: str) -> bool:
    from depthcli.models.catalog import list_locations

    return word in {name for name, _ in list_locations()}


def _toml_scalar(value: Any) -> Scalar:  # noqa: ANN401 - any option value
    if isinstance(value, Enum):
        value = value.value
    return value if isinstance(value, bool | int | float) else str(value)
