"""The command group, which imports a command when it is called, and the exit codes."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Sequence
from typing import Any

import typer
from typer.core import TyperGroup, TyperOption
from typer.main import get_command
from typer.models import TyperPath

from depthcli.cli import table
from depthcli.cli.groups import USUAL
from depthcli.cli.screen import console
from depthcli.core.options import suggestion
from depthcli.errors import DepthcliError, ExitCode, UsageError, is_out_of_memory

_EXTRAS = {
    "train": "torch lightning_fabric lightning_utilities onnx onnxscript h5py timm",
    "serve": "starlette uvicorn prometheus_client",
    "mcp": "mcp",
    "watch": "watchfiles",
}  #: modules that commands import at once, by the extra that installs them
# Metavars in help, instead of typer's type names, which depend on its version.
_PLACEHOLDERS = {"int": "N", "integer": "N", "float": "X", "path": "PATH"}
_PLACEHOLDERS |= dict.fromkeys(("str", "text"), "TEXT")
# Options of other programs, and what stands for them here.
_DEVICES = dict.fromkeys(("--device", "--gpu", "--cuda", "--cpu"), ("--provider", "--accelerator"))
_FOREIGN_NAMES = _DEVICES | {
    "--epochs": ("--set optim.epochs_constant=N and optim.epochs_decay=N",),
    "--lr": ("--set optim.learning_rate=X",),
    "--batch-size": ("--set optim.batch_size=N",),
}
"""Names that other programs have for ``--provider``."""


class LazyGroup(TyperGroup):
    """A group that imports a command's module when that command is called."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401, ARG002 - typer's own types
        """Names of the commands, in the order of the help."""
        return list(table.COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401 - typer's own types
        """One command; None during completion of an unknown one."""
        if cmd_name in table.COMMANDS:
            return load_command(cmd_name)
        if ctx.resilient_parsing:
            return None
        hint = suggestion(cmd_name, table.COMMANDS, f"see '{table.PROGRAM} --help'")
        raise UsageError(f"no command named {cmd_name!r}", hint)

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401, ARG002
        """The text of ``depthcli --help``."""
        formatter.write(table.help_text())


app = typer.Typer(
    cls=LazyGroup,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},  # every command inherits them
)


@app.callback()
def _root() -> None:
    """Monocular depth estimation on the command line."""


def run(arguments: Sequence[str]) -> int:
    """Run a command; prints its error, if any, and returns the exit code."""
    try:
        result = get_command(app)(
            args=list(arguments), prog_name=table.PROGRAM, standalone_mode=False
        )
    except SystemExit as stop:  # shell completion, a closed pipe, a signal
        return stop.code if isinstance(stop.code, int) else ExitCode.OK
    except Exception as error:  # noqa: BLE001 - any error is printed as one line
        if type(error).__name__ == "NoArgsIsHelpError":  # of "depthcli eval", for example
            console.out(error.ctx.get_help())  # type: ignore[attr-defined]
            return ExitCode.OK
        if "--debug" in arguments:
            traceback.print_exception(error)
        message, code = _explain(error)
        console.error(message)
        return code
    return result if isinstance(result, int) else ExitCode.OK


def _explain(error: Exception) -> tuple[str, int]:
    if isinstance(error, DepthcliError):
        return error.message, error.exit_code
    if isinstance(error, typer.Abort):
        return "interrupted", ExitCode.INTERRUPTED
    if hasattr(error, "format_message"):  # typer's own errors, all about usage
        return _usage_text(error), ExitCode.USAGE
    if is_out_of_memory(error):
        return "out of memory; give fewer or smaller inputs", ExitCode.FAILURE
    return _unexpected(error), ExitCode.FAILURE


def _unexpected(error: Exception) -> str:
    """Message of an error that is not depthcli's own, or how to install what it needs."""
    if isinstance(error, ModuleNotFoundError):
        module = (error.name or "").partition(".")[0]
        for extra in (extra for extra, modules in _EXTRAS.items() if module in modules.split()):
            return f"this needs {module}; install it with: pip install 'depthcli[{extra}]'"
    if isinstance(error, OSError) and error.strerror:
        return ": ".join(str(part) for part in (error.filename, error.strerror) if part)
    return f"unexpected {type(error).__name__}: {error}; run again with --debug for details"


def _usage_text(error: Any) -> str:  # noqa: ANN401 - typer's own types
    context = getattr(error, "ctx", None)
    path = context.command_path if context else table.PROGRAM
    message = error.format_message().strip().rstrip(".")
    foreign = _FOREIGN_NAMES.get(getattr(error, "option_name", None) or "")
    if context and foreign:
        names = {word for parameter in context.command.params for word in parameter.opts}
        hints = [f"; give {hint}" for hint in foreign if hint.split()[0] in names]
        message = "".join([f"no such option: {error.option_name}", *hints[:1]])
    start, _, end = message.partition("' is not one of ")
    hint = suggestion(start.split("'")[-1], re.findall("'(.*?)'", end), f"see '{path} --help'")
    return f"{message[0].lower()}{message[1:]}; {hint}"


def load_command(name: str) -> Any:  # noqa: ANN401 - typer's own types
    """Import one command, and add the options of the shell."""
    command = table.plain_command(name)
    if name in table.PROFILE_COMMANDS:
        command.params.append(
            TyperOption(
                param_decls=["--profile"],
                metavar="NAME",
                autocompletion=_profiles,
                expose_value=False,
                callback=_apply_profile,
                is_eager=True,
                help="Use the options in the table [NAME] of depthcli.toml; options on the command "
                "line override them.",
                rich_help_panel=USUAL,
            )
        )
    _add_common(command)
    return command


def _add_common(command: Any) -> None:  # noqa: ANN401 - typer's own types
    """Add ``--debug`` and ``--verbose`` to a command and to its subcommands."""
    for child in getattr(command, "commands", {}).values():
        _add_common(child)
    for parameter in command.params:
        if isinstance(parameter.type, TyperPath) and parameter.callback is None:
            parameter.callback = _refuse_uris
        if parameter.param_type_name == "option" and not parameter.is_flag:
            parameter.metavar = parameter.metavar or _PLACEHOLDERS.get(
                parameter.type.name.split()[0]
            )
    if hasattr(command, "commands") or any("--debug" in p.opts for p in command.params):
        return
    flag: dict[str, Any] = {"is_flag": True, "default": False, "expose_value": False}
    command.params += [
        TyperOption(
            param_decls=["-v", "--verbose"],
            **flag,
            callback=_log,
            help="Log what is done to stderr; DEPTHCLI_LOG=debug does so, too.",
        ),
        TyperOption(param_decls=["--debug"], **flag, help="Show the traceback of an error."),
    ]


def _log(_context: Any, _parameter: Any, verbose: bool) -> None:  # noqa: ANN401 - typer's own
    """Print the log of depthcli to standard error, at the level of ``DEPTHCLI_LOG`` or all."""
    level = "DEBUG" if verbose else os.environ.get("DEPTHCLI_LOG", "").upper()
    if level:
        import logging

        if level not in logging.getLevelNamesMapping():
            raise UsageError(f"DEPTHCLI_LOG is a level such as debug or info, not {level.lower()}")
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        logger = logging.getLogger("depthcli")
        logger.handlers = [handler]
        logger.setLevel(level)


def _refuse_uris(_ctx: Any, parameter: Any, value: Any) -> Any:  # noqa: ANN401 - typer's own types
    """Refuse URIs for local paths, which would take ``s3:`` for a folder."""
    for word in value if isinstance(value, (list, tuple)) else (value,):
        if "://" in str(word):
            from depthcli.io.storage.paths import safe_name

            named = parameter.opts[-1] if parameter.opts[-1].startswith("-") else "this"
            raise UsageError(f"{safe_name(str(word))} is a URI; {named} takes local paths only")
    return value


def _profiles(_context: Any, _words: Any, _word: str) -> list[str]:  # noqa: ANN401 - typer's own
    from depthcli.cli.profiles import profile_names

    return [*profile_names()]


def _apply_profile(ctx: Any, _parameter: Any, name: str | None) -> None:  # noqa: ANN401 - typer's own
    if name is not None and not ctx.resilient_parsing:
        from depthcli.cli.profiles import apply

        apply(ctx, name)
