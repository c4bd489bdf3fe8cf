"""Every n-th system call fails: what commands leave behind, and whether they say so.

::

    python -m robustness.every_call_fails [COMMAND...] [--calls open,write]
        [--errors ENOSPC,EIO] [--all]

runs each command of ``faulty_commands.py`` with its first, second, third ``open``, ``write``,
``fsync``, ``rename``, ``mkdir`` or ``read`` of a file below its folder failing, with each error
that the call can end with, until the run makes no such call any more. Calls of native libraries
(OpenEXR, FFmpeg, torch) are among them. Of calls that the same lines of Python make on files of one
suffix, the first and the last fail; with ``--all``, each. As on a full disk, in a folder that
became read-only and on a mount that is gone, all calls of the kind after it fail as well once more.
Calls on files elsewhere, those of Python and of packages, are left alone. After each:

- the exit code is 0 and all outputs are there, or it is 1, 2 or 3 with one line that says why;
- no file under a final name is half: each is what a run without faults writes, or what was there;
- the same command without a fault ends with 0, the same bytes, and no temporary file. (Once for
  each state of the folder that faults leave: most leave one that another has left before.)

It needs Linux and a C compiler.
"""

from __future__ import annotations

import argparse
import errno
import os
import subprocess
import sys
import tempfile
import traceback
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from robustness import faulty_commands
from robustness.faults import CALLS, ERRORS, LASTING, NAMES, Fault, Injector, library

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from robustness.faults import Ended
    from robustness.faulty_commands import Command

_LIBRARY = "DEPTHCLI_FAULTS"
_USAGE = 2
_LINES = 4
"""Lines of errors that a fault may cost: of a batch, one for each input and the manifest."""


def main() -> int:
    """Run what is asked for, and say what fell short."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("commands", nargs="*", metavar="COMMAND")
    parser.add_argument("--calls", default=",".join(CALLS))
    parser.add_argument("--errors", default=",".join(NAMES))
    parser.add_argument("--all", action="store_true", help="also those from the same place")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="faults-") as name:
        if _LIBRARY not in os.environ:
            return _preloaded(Path(name))
        return _run(options, Path(name))


def _preloaded(folder: Path) -> int:
    """This command once more, with the library loaded before all others."""
    path = library(folder)
    if path is None:
        print("needs Linux and a C compiler")
        return 2
    once = {"OMP_NUM_THREADS": "1", "LD_PRELOAD": str(path), _LIBRARY: str(path)}
    words = [sys.executable, "-m", "robustness.every_call_fails", *sys.argv[1:]]
    return subprocess.run(words, env={**os.environ, **once}, check=False).returncode


def _run(asked: argparse.Namespace, folder: Path) -> int:
    injector = Injector(Path(os.environ[_LIBRARY]), faulty_commands.ENVIRONMENT)
    # Each command is loaded in a process of its own: libraries that have run in one cannot be used
    # in those that are forked from it.
    names = asked.commands or faulty_commands.COMMANDS
    codes = [in_a_fork(partial(_attack, name, injector, folder, asked)) for name in names]
    return int(any(codes))


def _attack(name: str, injector: Injector, folder: Path, asked: argparse.Namespace) -> int:
    """All faults of one command; whether something fell short."""
    command = faulty_commands.COMMANDS[name]
    load(command)
    trial = Trial(injector, command, folder / name.replace(" ", "-"))
    count = short = 0
    for fault in trial.faults(asked.calls.split(","), asked.errors.split(","), asked.all):
        count += 1
        for problem in trial.problems(fault):
            short += 1
            print(f"{name}: {fault}: {problem}", flush=True)
    print(f"{name}: {count} faults of {trial.counts}, {short} fell short", flush=True)
    return int(short > 0)


def load(command: Command) -> None:
    """What the command loads, so that each fork has it."""
    from depthcli.cli.shell import load_command  # noqa: PLC0415

    load_command(command.words[0])
    for module in command.loads:
        import_module(module)


class Trial:
    """One command, again and again."""

    def __init__(self, injector: Injector, command: Command, folder: Path) -> None:
        self._injector, self._command = injector, command
        self._template = folder / "template"
        self._folder = folder / "run"
        self._template.mkdir(parents=True)
        if in_a_fork(lambda: command.prepare(self._template)):
            raise RuntimeError("inputs cannot be made")
        self._before = self._contents(self._template)
        faulty_commands.copied(self._template, self._folder)
        done, self._calls = self._injector.calls(command.words, self._folder)
        if done.code != 0:
            raise RuntimeError(f"{command.words}: {done.code}: {done.err}")
        self._whole = self._contents(self._folder)
        self._known: set[bytes] = set()
        self.counts = done.counts

    def faults(self, calls: list[str], errors: list[str], every: bool) -> Iterator[Fault]:
        """All that can befall it."""
        ends: dict[tuple[str, str], set[int]] = {}
        for call in self._calls:
            same = ends.setdefault((call.kind, call.place), set())
            ends[call.kind, call.place] = (
                {*same, call.number} if every else {min(same, default=call.number), call.number}
            )
        chosen = {(kind, number) for (kind, _), some in ends.items() for number in some}
        for call, number in sorted(chosen):
            for error in ERRORS[call] if call in calls else ():
                if errno.errorcode[error] in errors:
                    yield Fault(call, number, error)
                    if (call, error) in LASTING:
                        yield Fault(call, number, error, onwards=True)

    def problems(self, fault: Fault) -> Iterator[str]:
        """What fell short with a fault, and without one after it."""
        faulty_commands.copied(self._template, self._folder)
        done = self._injector.run(self._command.words, self._folder, fault)
        if not done.where:
            return  # in another order of threads there was no such call
        files = self._contents(self._folder)
        yield from (f"{problem} ({done.where})" for problem in self._said(done, files))
        for name, content in files.items():
            # What a run has done so far is another matter than half of it.
            may_grow = name in {"manifest.jsonl", "metrics.jsonl", "last.ckpt", "best.ckpt"}
            is_whole = content in (self._whole.get(name), self._before.get(name, b""))
            if content is None or not (is_whole or may_grow):
                yield f"{name} is half ({done.where})"
        state = faulty_commands.state(self._folder)
        if state not in self._known:
            again = list(self._again())
            yield from (f"{problem} ({done.where})" for problem in again)
            if not again:
                self._known.add(state)

    def _again(self) -> Iterator[str]:
        """What falls short of the same command without a fault."""
        again = self._injector.run(self._command.words, self._folder)
        files = self._contents(self._folder)
        if again.code != 0:
            # What was done in spite of the fault may refuse, as a usage error, to be done twice.
            if again.code != _USAGE or not self._whole.items() <= files.items():
                yield f"the next run ends with {again.code}: {again.err.strip()}"
            return
        if files != self._whole:
            others = {
                name for name in {*files, *self._whole} if files.get(name) != self._whole.get(name)
            }
            yield f"the next run leaves other bytes: {sorted(others)}"
        if left := faulty_commands.hidden(self._folder):
            yield f"the next run leaves {left}"

    def _said(self, done: Ended, found: dict[str, bytes | None]) -> Iterator[str]:
        errors = [line for line in done.err.splitlines() if line.startswith("depthcli: error")]
        if done.code == 0:
            missing = [name for name, content in self._whole.items() if found.get(name) != content]
            if missing:
                yield f"exit 0 without {missing}"
        elif done.code not in (1, 2, 3):
            yield f"exit {done.code}: {done.err.strip()[-300:]}"
        elif not 1 <= len(errors) <= _LINES:
            yield f"{len(errors)} lines of errors with exit {done.code}: {done.err.strip()}"
        if "unexpected" in done.err or "Traceback" in done.err:
            yield f"says {done.err.strip()}"

    def _contents(self, folder: Path) -> dict[str, bytes | None]:
        return faulty_commands.contents(folder, self._command)


def in_a_fork(work: Callable[[], int | None]) -> int:
    """The work's code; threads that it starts are of no use in processes that are forked later."""
    sys.stdout.flush()
    child = os.fork()
    if not child:
        code = 1
        try:
            code = work() or 0
        except Exception:  # noqa: BLE001 - a process of its own says it itself
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


if __name__ == "__main__":
    sys.exit(main())
