"""Videos that are read from a stream and written to one, front to back."""

import os
from typing import BinaryIO

from depthcli.errors import DepthcliError, InputError, OutputError

HEAD_BYTES = 256
"""Of a video, in which it says what it is and how long."""


class _Pipe:
    """A stream in FFmpeg's hands, which would swallow a ``KeyboardInterrupt`` in its callbacks."""

    _error: type[DepthcliError] = InputError

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._stopped: BaseException | None = None

    def check(self) -> None:
        """Raise what stopped the stream, if anything did; nothing more goes through it then.

        Raises:
            DepthcliError: it cannot be used.
            BrokenPipeError: its reader is gone.
        """
        reason = self._stopped
        if isinstance(reason, OSError) and not isinstance(reason, BrokenPipeError):
            raise self._error(f"{self} failed: {reason.strerror or reason}") from reason
        if reason is not None:
            raise reason


class InputPipe(_Pipe):
    """A stream that FFmpeg reads; where the stream seeks, as that of a file does, so does this."""

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__(stream)
        # What is there at once, so that live video is not held back.
        self._read = getattr(stream, "read1", stream.read)
        self.seekable, self.seek, self.tell = stream.seekable, stream.seek, stream.tell
        self.head = b""  #: the first bytes of it
        self._count = 0

    def __str__(self) -> str:
        return "standard input"

    def read(self, size: int) -> bytes:
        """Up to ``size`` bytes; none at the end."""
        try:
            data = b"" if self._stopped else bytes(self._read(size))
        except BaseException as reason:  # noqa: BLE001 - raised by check
            self._stopped = reason
            return b""
        self.head += data[: HEAD_BYTES - len(self.head)]
        self._count += len(data)
        return data

    @property
    def end(self) -> int:
        """Bytes of the stream, once it was read to its end."""
        return self.seek(0, os.SEEK_END) if self.seekable() else self._count


class OutputPipe(_Pipe):
    """A stream that FFmpeg writes.

    Attributes:
        suffix: says the container, ``.mkv`` say.
    """

    _error = OutputError

    def __init__(self, stream: BinaryIO, suffix: str) -> None:
        super().__init__(stream)
        self.suffix = suffix

    def __str__(self) -> str:
        return "standard output"

    def write(self, data: bytes) -> int:
        """Write all of it, and let the reader have it."""
        try:
            if self._stopped is None:
                self._stream.write(data)
                self._stream.flush()
        except BaseException as reason:  # noqa: BLE001 - raised by check
            self._stopped = reason
        return len(data)
