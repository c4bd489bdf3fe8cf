"""The command group, which imports a command when it is called; exit codes and signals.

An exception from a signal handler could be raised anywhere: within an import, a library's callback
or clean-up code. So a signal removes temporary files and ends the process at once, except in
commands that shut down gracefully.
"""

import os
import re
import select
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup, TyperOption
from typer.main import get_command
from typer.models import TyperPath

from depthcli.cli import groups, table
from depthcli.cli.screen import console
from depthcli.core.options import suggestion
from depthcli.core.parallel import Interrupt, run_exit_hooks
from depthcli.errors import SIGNAL_BASE, DepthcliError, ExitCode, UsageError, is_out_of_memory
from depthcli.io.storage.atomic import remove_own

_EXTRAS = {
    "train": "torch lightning_fabric lightning_utilities onnx onnxscript h5py timm",
    "serve": "starlette uvicorn prometheus_client",
    "mcp": "mcp",
    "watch": "watchfiles",
}  #: modules that commands import at once, by the extra that installs them
# Metavars in help, instead of typer's type names, which depend on its version.
_PLACEHOLDERS = {"int": "N", "integer": "N", "float": "X", "path": "PATH"}
_PLACEHOLDERS |= dict.fromkeys(("str", "text"), "TEXT")
_DEVICES = dict.fromkeys(("--device", "--gpu", "--cuda", "--cpu"), ("--provider", "--accelerator"))
_FOREIGN_NAMES = _DEVICES | {
    "--epochs": ("--set optim.epochs_constant=N and optim.epochs_decay=N",),
    "--lr": ("--set optim.learning_rate=X",),
    "--batch-size": ("--set optim.batch_size=N",),
}
"""Options of other programs, and what stands for them here."""


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
    message = f"unexpected {type(error).__name__}: {error}; run again with --debug for details"
    if isinstance(error, ModuleNotFoundError):
        module = (error.name or "").partition(".")[0]
        for extra in (extra for extra, modules in _EXTRAS.items() if module in modules.split()):
            message = f"this needs {module}; install it with: pip install 'depthcli[{extra}]'"
    elif isinstance(error, OSError) and error.strerror:
        message = ": ".join(str(part) for part in (error.filename, error.strerror) if part)
    return message, ExitCode.FAILURE


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
                rich_help_panel=groups.USUAL,
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
    from depthcli.cli.parse import profile_names

    return [*profile_names()]


def _apply_profile(ctx: Any, _parameter: Any, name: str | None) -> None:  # noqa: ANN401 - typer's own
    if name is not None and not ctx.resilient_parsing:
        from depthcli.cli.parse import apply_profile

        apply_profile(ctx, name)


_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP

_GRACE_PERIOD_S = 0.5
_shutdowns: list[tuple[float, Callable[[], object]]] = []
"""Grace period and callback of each :func:`graceful_shutdown` block; the innermost last."""


def ending_signals() -> tuple[signal.Signals, ...]:
    """The signals that end this process; not those that are ignored, as under nohup."""
    numbers = (getattr(signal, name) for name in _NAMES if hasattr(signal, name))
    return tuple(number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN)


def end_on_signals() -> None:
    """Make these signals end the process, also while its main thread runs native code."""
    read_end, write_end = os.pipe()
    if sys.platform != "win32":
        os.set_blocking(write_end, False)
    for number in ending_signals():
        signal.signal(number, _end)
    signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(read_end,), daemon=True).start()


class StopOnSignal(Interrupt):
    """A :class:`depthcli.core.parallel.Progress` that ends the work after a signal."""

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[float], None]:
        """A stage that checks for a signal after each unit."""
        del what, total, unit
        return lambda _count: self.check()

    def check(self) -> None:
        """Raise SystemExit if a signal came."""
        if self.number is not None:
            raise SystemExit(SIGNAL_BASE + self.number)


@contextmanager
def graceful_shutdown(
    grace_period_s: float, on_signal: Callable[[], object]
) -> Iterator[StopOnSignal]:
    """Record a signal within the block, which has to end then; a second one ends the process.

    The signal calls ``on_signal`` in another thread.
    """
    with StopOnSignal(*ending_signals()) as stop:
        _shutdowns.append((grace_period_s, on_signal))
        try:
            yield stop
        finally:
            _shutdowns.pop()


def _watch(read_end: int) -> None:
    """End the process on a signal if the main thread does not do so in time."""
    while True:
        (number,) = os.read(read_end, 1)
        if signal.getsignal(number) is _end:
            grace_period_s = _GRACE_PERIOD_S
        elif _shutdowns:
            grace_period_s, on_signal = _shutdowns[-1]
            on_signal()
        else:
            continue
        select.select([read_end], (), (), grace_period_s)
        _clean_up()
        os._exit(SIGNAL_BASE + number)


def _end(number: int, _frame: object) -> NoReturn:
    _clean_up()
    with suppress(Exception):  # the stream is closed, or was interrupted while writing
        sys.stdout.flush()
    os._exit(SIGNAL_BASE + number)


def _clean_up() -> None:
    run_exit_hooks()
    remove_own()
