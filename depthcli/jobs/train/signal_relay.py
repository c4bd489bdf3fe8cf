"""Handing on signals to a process that we wait for."""

import signal
import subprocess
from collections.abc import Iterable

from depthcli.core.interrupt import Interrupt


class SignalRelay(Interrupt):
    """While entered, signals go to a process, which decides when it ends; ``number`` is the first.

    The process has a process group of its own: a terminal would tell it too, and a second signal
    means something else than the first.
    """

    def __init__(self, signals: Iterable[signal.Signals]) -> None:
        super().__init__(*signals)
        self._process: subprocess.Popen[bytes] | None = None

    def to(self, process: subprocess.Popen[bytes]) -> None:
        """Name the process; a signal that came before goes to it now."""
        self._process = process
        if self.number is not None:
            process.send_signal(self.number)

    def _note(self, number: int, _frame: object) -> None:
        if self.number is None:
            self.number = number
        if self._process is not None:
            self._process.send_signal(number)
