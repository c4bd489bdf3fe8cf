"""Hooks that run when the process exits at once, without unwinding the stack."""

import contextlib
from collections.abc import Callable, Iterator

_actions: list[Callable[[], object]] = []


@contextlib.contextmanager
def exit_hook(action: Callable[[], object]) -> Iterator[None]:
    """Call a function if the process exits within the block.

    Args:
        action: called from a signal handler or another thread, at any point of this one.
    """
    _actions.append(action)
    try:
        yield
    finally:
        _actions.remove(action)


def run_exit_hooks() -> None:
    """Call all hooks, the last one first; their exceptions are ignored."""
    for action in reversed(_actions):
        with contextlib.suppress(Exception):
            action()
