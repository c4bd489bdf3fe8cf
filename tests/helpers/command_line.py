"""The command line of the built wheel, run as a user runs it."""

import contextlib
import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import Any

import pytest

from depthcli.cli.app import main

ROOT = Path(__file__).resolve().parents[2]


def unmeasured(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Without what has a process write its coverage.

    It could not under a limit, nor in a signal handler: it would wait for ever for a lock of
    coverage's that is held by the call which the signal interrupted.
    """
    return {name: value for name, value in environment.items() if not name.startswith("COVERAGE_")}


def finished(
    command: Sequence[str | os.PathLike[str]], folder: Path, **options: Any
) -> subprocess.CompletedProcess[str]:
    """A program that was run in a folder to its end; options as of ``subprocess.run``."""
    settings = {"capture_output": True, "text": True, "timeout": 120, **options}
    return subprocess.run(command, cwd=folder, check=False, **settings)


@dataclass(frozen=True)
class Cli:
    """The installed wheel's command line, run in a folder away from the source.

    Its default model is the tiny one.
    """

    site: Path
    folder: Path
    models: Path

    @property
    def environment(self) -> dict[str, str]:
        """The wheel first; the tests' own folder is never on the path."""
        home = str(self.folder.parent / "home")  # the tester's own models and profiles stay out
        env = {"DEPTHCLI_MODELS": str(self.models), "XDG_DATA_HOME": home, "XDG_CONFIG_HOME": home}
        return {**os.environ, "PYTHONPATH": str(self.site), **env}

    def __call__(
        self,
        *arguments: str | os.PathLike[str],
        stdin: bytes = b"",
        code: int | None = None,
        **environment: str,
    ) -> subprocess.CompletedProcess[bytes]:
        """Run a command to its end, with this exit code if one is given."""
        done = self.run(arguments, stdin, environment)
        assert code is None or done.returncode == code, done.stderr
        return done

    def run(
        self, arguments: Sequence[str | os.PathLike[str]], stdin: bytes, environment: dict[str, str]
    ) -> subprocess.CompletedProcess[bytes]:
        return subprocess.run(
            self.command(*arguments),
            input=stdin,
            capture_output=True,
            cwd=self.folder,
            env={**self.environment, **environment},
            check=False,
            timeout=60,
        )

    def started(
        self,
        *arguments: str | os.PathLike[str],
        stdin: int | None = None,
        stdout: int = subprocess.PIPE,
    ) -> subprocess.Popen[bytes]:
        """Start a command that is going to be interrupted, or left by its reader."""
        return subprocess.Popen(
            self.command(*arguments),
            stdin=stdin,
            stdout=stdout,
            stderr=subprocess.PIPE,
            cwd=self.folder,
            env=unmeasured(self.environment),
        )

    def on_a_terminal(
        self, *arguments: str | os.PathLike[str], columns: int = 100, **environment: str
    ) -> tuple[int, str]:
        """Exit code of a command, and all that its terminal got."""
        ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 40, columns, 0, 0))
        with os.fdopen(ours, "rb", buffering=0) as terminal:
            process = subprocess.Popen(
                self.command(*arguments),
                stdin=theirs,
                stdout=theirs,
                stderr=theirs,
                cwd=self.folder,
                env={**self.environment, "TERM": "xterm", **environment},
            )
            os.close(theirs)
            output = b""
            with contextlib.suppress(OSError):  # how a closed terminal reads on Linux
                while piece := terminal.read(4096):
                    output += piece
        return process.wait(timeout=60), output.decode()

    def command(self, *arguments: str | os.PathLike[str]) -> list[str]:
        """The words of a command, for tests that start the process themselves."""
        return [sys.executable, "-m", "depthcli", *(os.fspath(word) for word in arguments)]


class InProcess(Cli):
    """The source's command line within the tests' process, where shell and start do not matter."""

    def run(
        self, arguments: Sequence[str | os.PathLike[str]], stdin: bytes, environment: dict[str, str]
    ) -> subprocess.CompletedProcess[bytes]:
        stream_in, out, err = BytesIO(stdin), BytesIO(), BytesIO()
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(self.folder)
            for name, value in {**self.environment, **environment}.items():
                patch.setenv(name, value)
            for name, stream in (("stdin", stream_in), ("stdout", out), ("stderr", err)):
                patch.setattr(sys, name, TextIOWrapper(stream, "utf-8", write_through=True))
            code = main([os.fspath(word) for word in arguments])
            outputs = out.getvalue(), err.getvalue()
        return subprocess.CompletedProcess(arguments, code, *outputs)
