"""What is done before a process ends at once."""

from depthcli.core.progress import exit_hook, run_exit_hooks


def test_the_last_action_is_taken_first_and_none_stops_another() -> None:
    done: list[str] = []
    with exit_hook(lambda: done.append("first")):
        with exit_hook(lambda: 1 / 0), exit_hook(lambda: done.append("last")):
            run_exit_hooks()
        assert done == ["last", "first"]
        run_exit_hooks()
    run_exit_hooks()
    assert done == ["last", "first", "first"]
