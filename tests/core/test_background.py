"""Work that goes on while the caller does something else."""

import threading

import pytest

from depthcli.core.parallel import Background


def test_the_result_is_waited_for() -> None:
    go_on = threading.Event()
    work = Background(lambda: (go_on.wait(60), threading.current_thread().daemon))
    go_on.set()
    assert work.result() == (True, True)
    assert work.result() == (True, True)


def test_errors_are_raised_by_result() -> None:
    work = Background(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        work.result()
