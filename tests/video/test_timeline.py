"""Times of frames whose timestamps repeat or go back."""

from __future__ import annotations

from fractions import Fraction

import pytest

from depthcli.video.frames import Timeline


@pytest.mark.parametrize(
    ("stated_ms", "times_ms"),
    [
        ([0, 40, 80, 120], [0, 40, 80, 120]),
        ([0, 40, 40, 40, 80, 120], [0, 40, 41, 42, 80, 120]),  # several frames in a millisecond
        ([0, 40, 39, 80], [0, 40, 41, 80]),
        ([0, 40, 80, 0, 40], [0, 40, 80, 120, 160]),  # joined streams
    ],
)
def test_only_frames_without_a_time_of_their_own_move(
    stated_ms: list[int], times_ms: list[int]
) -> None:
    timeline = Timeline(Fraction(25), Fraction(1, 1000), 0, is_constant=False)
    times = [timeline.add(ticks, 0)[1] for ticks in stated_ms]
    assert times == [Fraction(ms, 1000) for ms in times_ms]
