"""How the cores are divided."""

from __future__ import annotations

import pytest

from depthcli.core.parallel import cores


@pytest.mark.parametrize(
    ("asked", "shared"),
    [
        ((None, None), (8, 1)),
        ((1, None), (1, 8)),
        ((3, None), (3, 2)),
        ((20, None), (20, 1)),
        ((None, 4), (8, 4)),
        ((2, 5), (2, 5)),
    ],
)
def test_each_worker_has_its_share_of_eight_cores(
    monkeypatch: pytest.MonkeyPatch, asked: tuple[int | None, ...], shared: tuple[int, int]
) -> None:
    monkeypatch.setattr(cores, "usable_cores", lambda: 8)
    assert cores.share_cores(*asked) == shared
