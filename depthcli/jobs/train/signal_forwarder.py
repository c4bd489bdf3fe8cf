"""Forwarding signals to a child process."""

import signal
import subprocess
from collections.abc import Iterable

from depthcli.core.interrupt import Interrupt


class SignalForwarder(Interrupt):
    """While entered, forwards signals to a process; ``number`` is the first one.

    The process needs a process group of its own: else a terminal would signal it as well, and a
    second signal means something else than the first.
    """

    def __init__(self, signals: Iterable[signal.Signals]) -> None:
        super().__init__(*signals)
        self._process: subprocess.Popen[bytes] | None = None

    def forward_to(self, process: subprocess.Popen[bytes]) -> None:
        """Set the process; a signal received before is sent now."""
        self._process = process
        if self.number is not None:
            process.send_signal(self.number)

    def _handle(self, number: int, _frame: object) -> None:
        if self.number is None:
            self.number = number
        if self._process is not None:
            self._process.send_signal(number)
