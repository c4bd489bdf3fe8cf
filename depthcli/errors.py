"""Every error that depthcli raises on purpose, and the exit code each one ends in.

Messages are one line and say what to do. Libraries raise them; only ``depthcli.cli`` turns them
into exit codes and names the options of the command line in them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import ClassVar, Self

SIGNAL_BASE = 128  #: exit code of a process that a signal ended, less the signal's number
_OPENCV_NO_MEMORY = -4  # cv2.Error.StsNoMem, without loading OpenCV
_IN_PYTHON = {"hfov": "hfov_deg", "baseline": "baseline_m", "from_scale": "png_scale"}
_IN_PYTHON |= {"from_kind": "kind", "from_layer": "layer"}
_IN_PYTHON |= {"out": "path", "overwrite": "overwrite=True"}
"""Names in Python of parameters that the command line calls otherwise."""


class ExitCode(IntEnum):
    """Exit codes of the process."""

    OK = 0
    SOME_FAILED = 1
    USAGE = 2
    FAILURE = 3
    INTERRUPTED = 130


class Message(str):
    """One line about a problem; as text it names Python's parameters, :meth:`worded` others.

    Attributes:
        problem: the fact, with names of files and values as they are.
        advice: what to do, with parameters in braces: ``"raise {max_pixels}"``.
        option: the parameter whose value is wrong; stands before the problem.
    """

    __slots__ = ("advice", "option", "problem")
    problem: str
    advice: str
    option: str

    def __new__(cls, problem: str, advice: str = "", *, option: str = "") -> Self:  # noqa: D102
        message = super().__new__(cls, _joined(problem, advice, option, _python_name))
        message.problem, message.advice, message.option = problem, advice, option
        return message

    def __getnewargs_ex__(self) -> tuple[tuple[str, str], dict[str, str]]:
        return (self.problem, self.advice), {"option": self.option}

    def worded(self, word: Callable[[str], str]) -> str:
        """The line with each parameter as ``word`` names it, ``--max-pixels`` for example."""
        return _joined(self.problem, self.advice, self.option, word)

    def about(self, subject: str) -> Message:
        """The message with what it is about before the problem: ``"a.png: …"``."""
        return Message(f"{subject}: {self.problem}", self.advice, option=self.option)


def about(subject: str, text: str) -> str:
    """A line that begins with what it is about, unless it names that; a message stays one."""
    if subject in text:
        return text
    return text.about(subject) if isinstance(text, Message) else f"{subject}: {text}"


def _python_name(parameter: str) -> str:
    return _IN_PYTHON.get(parameter, parameter)


def _joined(problem: str, advice: str, option: str, word: Callable[[str], str]) -> str:
    sentence = re.sub(r"\{([a-z_][a-z0-9_]*)\}", lambda match: word(match[1]), advice)
    line = "; ".join(part for part in (problem, sentence) if part)
    return f"{word(option)}: {line}" if option else line


class DepthcliError(Exception):
    """Base of every error raised on purpose; ``str(error)`` is its :class:`Message`."""

    exit_code: ClassVar[ExitCode] = ExitCode.FAILURE

    def __init__(self, problem: str = "", advice: str = "", *, option: str = "") -> None:
        if isinstance(problem, Message):
            advice, option = advice or problem.advice, option or problem.option
            problem = problem.problem
        problem = Message(problem, advice, option=option)
        self.message: Message = problem
        super().__init__(self.message)


class DepthcliWarning(UserWarning):
    """A caveat about a result, issued through Python's warnings."""


class UsageError(DepthcliError):
    """The command or its options do not fit together."""

    exit_code = ExitCode.USAGE


class InputError(DepthcliError):
    """One input cannot be used: missing, empty, truncated, not an image, too large."""

    exit_code = ExitCode.SOME_FAILED


class OutputError(DepthcliError):
    """One output cannot be written: read-only folder, full disk, an input in its place."""

    exit_code = ExitCode.SOME_FAILED


class ModelError(DepthcliError):
    """A model cannot be used: missing, damaged, without a card, or checksum differs."""


class ProviderError(ModelError):
    """An execution provider asked for by name is not available."""


class ParityError(ModelError):
    """An exported model does not reproduce the network that it was exported from."""


class EngineError(DepthcliError):
    """A cluster cannot be used: not there, of another version, or without room."""


class DatasetError(DepthcliError):
    """A data set cannot be read: missing, empty, unpaired, or depth in another unit."""

    exit_code = ExitCode.USAGE


class CheckpointError(DepthcliError):
    """A checkpoint cannot be loaded: truncated, foreign, or made with other settings."""


class TrainingError(DepthcliError):
    """Training cannot go on; the last good checkpoint is kept."""


@contextmanager
def os_errors_as(
    kind: type[DepthcliError], problem: str, advice: str = "", *, option: str = ""
) -> Iterator[None]:
    """Raise an OSError of the block as an error of ours, whose problem ends in the reason.

    BrokenPipeError stays: the reader has exited, which is not an error.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise kind(f"{problem}: {error.strerror or error}", advice, option=option) from error


def is_out_of_memory(error: BaseException) -> bool:
    """Whether there was too little memory: Python's own error, or OpenCV's."""
    return isinstance(error, MemoryError) or (
        type(error).__module__ == "cv2" and getattr(error, "code", None) == _OPENCV_NO_MEMORY
    )
