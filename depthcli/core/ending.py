"""What is done before the process ends at once, without unwinding."""

import contextlib
from collections.abc import Callable, Iterator

_actions: list[Callable[[], object]] = []


@contextlib.contextmanager
def before_ending(action: Callable[[], object]) -> Iterator[None]:
    """Have an action taken if the process is ended within the block.

    Args:
        action: called from a signal handler or another thread, whatever this one is doing.
    """
    _actions.append(action)
    try:
        yield
    finally:
        _actions.remove(action)


def prepare_to_end() -> None:
    """Take all actions, the last one first; what one of them raises is dropped."""
    for action in reversed(_actions):
        with contextlib.suppress(Exception):
            action()
