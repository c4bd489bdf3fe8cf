"""A profile's options as defaults of a command; the command line overrides them."""

from collections.abc import Iterable, Mapping
from typing import Any

from depthcli.cli import parse as camera
from depthcli.cli import profile_files
from depthcli.cli.checks import is_given
from depthcli.cli.loading import plain_command, suggestion
from depthcli.cli.parse import (
    check_anchors,
    choose_detail,
    parse_camera,
    parse_fps,
    parse_span,
    provider_options,
    writer_options,
)
from depthcli.cli.profile_files import Scalar, Value
from depthcli.cli.table import COMMANDS, PROFILE_COMMANDS
from depthcli.core.options import Upsampling
from depthcli.errors import UsageError
from depthcli.io.formats.table import format_of
from depthcli.jobs.naming import is_folder
from depthcli.video.formats import video_format_of

_NOT_SAVED = frozenset({"help", "debug", "profile", "output", "out"})
"""Options that profiles do not hold: those of one run or of the command line itself."""
_ALTERNATIVES = (
    *camera.ALTERNATIVES,
    ("rectified", "cameras", "focal_px", "hfov"),
    ("rectified", "centre_px"),
    ("anchor", "anchors"),
    ("png_scale", "png_normalize"),
    ("colormap", "near"),
)
_FORMAT, _FORMATS, _OUTPUT = "format", "formats", "output"
_FOLDERS_ONLY = "batch"


class Defaults(dict[str, Any]):
    """Defaults by parameter name, ignored if an option on the command line excludes them.

    Options on the command line are processed first, so they are known when a default is looked up.
    """

    def __init__(self, context: Any, values: dict[str, Any]) -> None:  # noqa: ANN401 - typer's own
        super().__init__(values)
        self._context = context

    def get(self, name: str, default: Any = None) -> Any:  # noqa: ANN401 - as dict has it
        """The default of a parameter that is not on the command line."""
        return default if self._is_overridden(name) else super().get(name, default)

    def _is_overridden(self, name: str) -> bool:
        others = {other for pair in _ALTERNATIVES if name in pair for other in pair} - {name}
        if any(is_given(self._context, other) for other in others):
            return True
        if name != _FORMATS or not is_given(self._context, _OUTPUT):
            return False
        output = str(self._context.params.get(_OUTPUT))
        names_format = format_of(output) is not None or video_format_of(output) is not None
        return names_format and self._context.info_name != _FOLDERS_ONLY and not is_folder(output)


def apply(context: Any, _parameter: Any, name: str | None) -> None:  # noqa: ANN401 - typer's own
    """Set a profile's options as the defaults of the current command.

    Raises:
        UsageError: there is no such profile, or one of its options or values is invalid.
    """
    if name is None or context.resilient_parsing:
        return
    own = options_of(context.command)
    defaults: dict[str, Any] = {}
    for key, value in profile_files.read_profile(name).items():
        if key == _FORMAT and not (value := _formats_of(own[key], value)):
            continue
        if key in own:
            defaults[str(own[key].name)] = _check_value(context, name, key, own[key], value)
        elif key not in _all_keys():
            meant = suggestion(key, _all_keys(), "depthcli profile save")
            raise UsageError(f"profile {name!r}: no option named {key!r}{meant}")
    context.default_map = Defaults(context, defaults)


def options_of(command: Any) -> dict[str, Any]:  # noqa: ANN401 - typer's own types
    """A command's options that a profile may hold, by name without leading dashes."""
    found = {}
    for parameter in command.params:
        long = max((word for word in parameter.opts if word.startswith("--")), key=len, default="")
        if long and long[2:] not in _NOT_SAVED:
            found[long[2:]] = parameter
    return found


def profiled_commands() -> Iterable[Any]:
    """The commands that accept profiles."""
    return (plain_command(name) for name in COMMANDS if name in PROFILE_COMMANDS)


def _all_keys() -> set[str]:
    return {key for command in profiled_commands() for key in options_of(command)}


def _formats_of(parameter: Any, value: Value) -> list[Scalar]:  # noqa: ANN401 - typer's own types
    """The formats of a profile, without those of other commands only."""
    found, own = value if isinstance(value, list) else [value], parameter.type.choices
    if all(name in own for name in found):
        return found  # the other commands are not imported
    of_any = {name for one in profiled_commands() for name in options_of(one)[_FORMAT].type.choices}
    return [name for name in found if name in own or name not in of_any]


def _check_value(
    context: Any,  # noqa: ANN401 - typer's own types
    name: str,
    key: str,
    parameter: Any,  # noqa: ANN401 - typer's own types
    value: Value,
) -> Value:
    """A value as the command line would give it, after checking it."""
    if parameter.multiple and not isinstance(value, list):
        value = [value]
    for part in value if isinstance(value, list) else [value]:
        if not _has_type(part, parameter):
            kind = "a whole number" if isinstance(part, float) else "a switch"
            what = "has to be" if isinstance(part, float) else "is not"
            raise UsageError(f"profile {name!r}: {key} {what} {kind}")
    try:
        parameter.process_value(context, value)
    except Exception as error:
        message = getattr(error, "message", None) or str(error)
        raise UsageError(
            f"profile {name!r}: {key} = {value!r}: {str(message).rstrip('.')}"
        ) from error
    return value


def _has_type(value: Scalar, parameter: Any) -> bool:  # noqa: ANN401 - typer's own types
    """Whether a value keeps its meaning; typer takes true for 1, and 2.5 for 2."""
    if isinstance(value, bool):
        return bool(parameter.is_flag)
    is_whole = not isinstance(value, float) or value.is_integer()
    return is_whole or not parameter.type.name.startswith("int")


def check_together(values: Mapping[str, Value]) -> None:
    """Run the checks that ``predict``, ``batch`` and ``video`` run before they read anything.

    Keys are option names without leading dashes.

    Raises:
        UsageError: an option is invalid, or options contradict each other.
    """

    def words(key: str) -> list[str]:
        value = values.get(key, [])
        return [str(part) for part in value] if isinstance(value, list) else [str(value)]

    def word(key: str) -> str | None:
        return words(key)[-1] if key in values else None

    scale = values.get("anchors-scale")
    given = {key.replace("-", "_"): value for key, value in values.items()}
    parse_camera(given)
    check_anchors(words("anchor"), word("anchors"), scale if isinstance(scale, float) else None)
    choose_detail(Upsampling.BILINEAR, word("tile"))
    parse_fps(word("fps"))
    parse_span(word("start"), word("end"), word("every"))
    provider_options(words("provider-option"))
    writer_options(given)
    if "provider" in values:
        from depthcli.inference.providers import check_name

        check_name(str(values["provider"]))
