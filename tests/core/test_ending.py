"""What is done before a process ends at once."""

from __future__ import annotations

from depthcli.core.ending import before_ending, prepare_to_end


def test_the_last_action_is_taken_first_and_none_stops_another() -> None:
    done: list[str] = []
    with before_ending(lambda: done.append("first")):
        with before_ending(lambda: 1 / 0), before_ending(lambda: done.append("last")):
            prepare_to_end()
        assert done == ["last", "first"]
        prepare_to_end()
    prepare_to_end()
    assert done == ["last", "first", "first"]
