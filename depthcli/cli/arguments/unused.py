"""Refusing options that none of the output formats uses."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from depthcli.errors import UsageError
from depthcli.io.formats.table import FORMATS

PICTURE_OPTIONS = {str(name): facts.parameters for name, facts in FORMATS.items()}
"""The options that each format uses, by parameter name."""


def refuse_unused(
    context: Any,  # noqa: ANN401 - typer's own
    formats: Collection[str],
    used_by: Mapping[str, Collection[str]],
) -> None:
    """Refuse an option on the command line that no output format uses.

    Options of a profile, which serves several runs, may be unused.

    Raises:
        UsageError: there is such an option.
    """
    for name, word in given_options(context).items():
        users = [format_ for format_, options in used_by.items() if name in options]
        if users and set(users).isdisjoint(formats):
            raise UsageError(
                f"{word} is for {_alternatives(users)}, and only {' and '.join(formats)} would be "
                "written; remove it, or choose another format"
            )


def _alternatives(names: Sequence[str]) -> str:
    """``a``, ``a or b``, ``a, b or c``."""
    return " or ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def given_options(context: Any) -> dict[str, str]:  # noqa: ANN401 - typer's own
    """The options given on the command line: parameter name -> option."""
    parameters = {}
    for parameter in context.command.params:
        is_off = parameter.secondary_opts and context.params.get(parameter.name) is False
        parameters[str(parameter.name)] = parameter.secondary_opts if is_off else parameter.opts
    return {
        name: max(words, key=len) for name, words in parameters.items() if is_given(context, name)
    }


def is_given(context: Any, name: str) -> bool:  # noqa: ANN401 - typer's own
    """Whether a parameter is given on the command line, not only in a profile."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"
