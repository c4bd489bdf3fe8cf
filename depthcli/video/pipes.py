"""Streams that videos are read from and written to sequentially."""

from typing import BinaryIO

from depthcli.errors import DepthcliError, InputError, OutputError


class _Pipe:
    """A stream that FFmpeg uses by callbacks, in which it would ignore a ``KeyboardInterrupt``."""

    _error: type[DepthcliError] = InputError

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._stopped: BaseException | None = None

    def check(self) -> None:
        """Raise the error of an earlier callback, if there was one; the stream is stopped then.

        Raises:
            DepthcliError: it cannot be used.
            BrokenPipeError: its reader has closed it.
        """
        reason = self._stopped
        if isinstance(reason, OSError) and not isinstance(reason, BrokenPipeError):
            raise self._error(f"{self} failed: {reason.strerror or reason}") from reason
        if reason is not None:
            raise reason


class InputPipe(_Pipe):
    """A stream that FFmpeg reads; seekable if the wrapped stream is."""

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__(stream)
        # Read what is available, so that live video is not delayed.
        self._read = getattr(stream, "read1", stream.read)
        self.seekable, self.seek, self.tell = stream.seekable, stream.seek, stream.tell

    def __str__(self) -> str:
        return "standard input"

    def read(self, size: int) -> bytes:
        """Up to ``size`` bytes; none at the end."""
        try:
            return b"" if self._stopped else bytes(self._read(size))
        except BaseException as reason:  # noqa: BLE001 - raised by check
            self._stopped = reason
            return b""


class OutputPipe(_Pipe):
    """A stream that FFmpeg writes.

    Attributes:
        suffix: chooses the container, such as ``.mkv``.
    """

    _error = OutputError

    def __init__(self, stream: BinaryIO, suffix: str) -> None:
        super().__init__(stream)
        self.suffix = suffix

    def __str__(self) -> str:
        return "standard output"

    def write(self, data: bytes) -> int:
        """Write and flush all data."""
        try:
            if self._stopped is None:
                self._stream.write(data)
                self._stream.flush()
        except BaseException as reason:  # noqa: BLE001 - raised by check
            self._stopped = reason
        return len(data)
