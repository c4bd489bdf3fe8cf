"""Options as dataclasses: each field is an option, and a command gets the objects.

The first line of the class's docstring is the heading of its options in the help.
"""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import partial, wraps
from typing import Annotated, Any, TypeVar, dataclass_transform, get_type_hints

import typer
from typer.core import TyperCommand
from typer.main import get_command

from depthcli.core.options import Rule
from depthcli.io.formats.table import HELP

_T = TypeVar("_T")
OPTION = "option"
"""Key of a field's metadata with its option; other fields are annotated with theirs."""
USUAL = "Options"  #: heading of the options that most runs need, which come first
_COLUMNS = 2, 26  # of the help: indent, and the widest name of an option beside its text
_keyword = partial(inspect.Parameter, kind=inspect.Parameter.KEYWORD_ONLY)


class Given(dict[str, str]):
    """Options on the command line, not in a profile: parameter -> word, such as ``--no-audio``."""

    @classmethod
    def of(cls, context: typer.Context, values: Mapping[str, Any] | None = None) -> Given:
        """The options that the command of a context was given; ``values`` tell off from on."""
        words_of = cls()
        for parameter in context.command.params:
            name, words = str(parameter.name), parameter.opts
            source = context.get_parameter_source(name)
            if source is None or source.name != "COMMANDLINE":
                continue
            if parameter.secondary_opts and values and values.get(name) is False:
                words = parameter.secondary_opts
            words_of[name] = max(words, key=len)
        return words_of


def checked(rule: Rule) -> Callable[[float | None], float | None]:
    """A callback of typer that refuses a value outside a range, unless it is None."""

    def check(value: float | None) -> float | None:
        if value is not None and not rule.holds(value):
            raise typer.BadParameter(f"must be {rule.what}")
        return value

    return check


@dataclass_transform(frozen_default=True, kw_only_default=True)
def group(kind: type[_T]) -> type[_T]:
    """Make a frozen dataclass of options, without what would only take time at start-up."""
    return dataclass(frozen=True, kw_only=True, repr=False, eq=False)(kind)


class Command(TyperCommand):
    """A command whose help groups the options by purpose."""

    def format_options(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401 - typer's own
        """Write a section for the arguments and for each group of options."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], USUAL: []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                is_argument = parameter.param_type_name == "argument"
                panel = getattr(parameter, "rich_help_panel", None) or USUAL
                sections.setdefault("Arguments" if is_argument else panel, []).append(record)
        for heading, records in sections.items():
            if records:
                with formatter.section(heading):
                    formatter.write_dl(records, col_max=_COLUMNS[1], col_spacing=_COLUMNS[0])


def command_of(
    functions: Callable[..., int] | Mapping[str, Callable[..., int]], text: str = ""
) -> Any:  # noqa: ANN401 - typer's own
    """The command of a function, whose parameters may be groups, or that of several by name.

    Without a name, that of "" is called, if there is one.
    """
    app = typer.Typer(rich_markup_mode=None, add_completion=False, help=text)
    if not isinstance(functions, Mapping):
        app.command(cls=Command)(grouped(functions))
        return get_command(app)
    usual = functions.get("")

    @app.callback(invoke_without_command=usual is not None, no_args_is_help=usual is None)
    def begin(context: typer.Context) -> None:
        if usual is not None and context.invoked_subcommand is None:
            usual()

    for name in filter(None, functions):
        app.command(name, cls=Command)(grouped(functions[name]))
    return get_command(app)


def grouped(command: Callable[..., int]) -> Callable[..., int]:
    """Flatten the groups among a command's parameters into options, for typer.

    A parameter of type :class:`Given` gets the options that are on the command line.
    """
    hints = get_type_hints(command, include_extras=True)
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        if is_dataclass(hints[name]):
            parameters += _flattened(hints[name])
        elif hints[name] is Given:
            parameters.append(_keyword("context", annotation=typer.Context))
        else:
            parameters.append(_keyword(name, default=parameter.default, annotation=hints[name]))

    @wraps(command)
    def flat(**values: Any) -> int:  # noqa: ANN401 - options of any type
        context = values.pop("context", None)
        words = {name: Given.of(context, values) for name, kind in hints.items() if kind is Given}
        groups = {name: _made(kind, values) for name, kind in hints.items() if is_dataclass(kind)}
        return command(**values, **groups, **words)

    flat.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    flat.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return flat


def _flattened(group: Any) -> Iterator[inspect.Parameter]:  # noqa: ANN401 - a dataclass
    """A group's fields, and those of the groups within it, or that it joins, as parameters."""
    if len(group.__bases__) > 1:
        for base in group.__bases__:
            yield from _flattened(base)
        return
    heading = str(group.__doc__).partition("\n")[0].rstrip(".")
    hints = get_type_hints(group, include_extras=True)
    for field in fields(group):
        kind = hints[field.name]
        if is_dataclass(kind):
            yield from _flattened(kind)
            continue
        if OPTION in field.metadata:
            kind = Annotated[kind, field.metadata[OPTION]]
        elif HELP in field.metadata:
            kind = Annotated[kind, _format_option(field.name, **field.metadata)]
        option = copy.copy(kind.__metadata__[0])
        option.rich_help_panel = option.rich_help_panel or heading
        if field.default is False and option.default is ... and not option.param_decls:
            option.param_decls = (f"--{field.name.replace('_', '-')}",)  # and no --no-…
        kind = Annotated[kind.__origin__, option]
        default = inspect.Parameter.empty if field.default is MISSING else field.default
        yield _keyword(field.name, default=default, annotation=kind)


def _format_option(name: str, help: str, rule: Rule | None, *, is_usual: bool) -> Any:  # noqa: A002, ANN401 - typer's own
    """The option of a field of the output formats; one in metres is named without the unit."""
    plain = name.removesuffix("_m")
    metres = (f"--{plain.replace('_', '-')}",) if plain != name else ()
    return typer.Option(
        *metres,
        help=help,
        callback=checked(rule) if rule else None,
        metavar="METRES" if metres else None,
        rich_help_panel=USUAL if is_usual else None,
    )


def _made(group: Any, values: dict[str, Any]) -> Any:  # noqa: ANN401 - a dataclass
    """The object of a group; takes its values out of ``values``."""
    hints = get_type_hints(group)
    return group(
        **{
            field.name: _made(hints[field.name], values)
            if is_dataclass(hints[field.name])
            else values.pop(field.name)
            for field in fields(group)
        }
    )
