"""A function that runs in a background thread."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

_Result = TypeVar("_Result")


class Background(Generic[_Result]):
    """One function, started at once in its own thread.

    The standard library's executors do the same, but importing them takes longer than is saved.
    """

    def __init__(self, function: Callable[[], _Result]) -> None:
        self._function = function
        self._result: list[_Result] = []
        self._error: BaseException | None = None
        # A daemon, so that Ctrl-C need not wait for a model that loads for seconds.
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def result(self) -> _Result:
        """Wait for the function; return what it returned, or raise what it raised."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._result[0]

    def _run(self) -> None:
        try:
            self._result.append(self._function())
        except BaseException as error:  # noqa: BLE001 - raised again by result()
            self._error = error
