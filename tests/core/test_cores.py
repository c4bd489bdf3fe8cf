"""How the cores are divided."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from depthcli.core import parallel as cores


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


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs affinity masks")
def test_cores_that_the_process_may_not_use_do_not_count() -> None:
    code = (
        "import os\n"
        "from depthcli.core.parallel import share_cores, usable_cores\n"
        "os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "print(usable_cores(), *share_cores())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert done.stdout.split() == [b"1", b"1", b"1"]


@pytest.mark.parametrize(
    ("text", "usable"),
    [("max 100000", 8), ("150000 100000", 2), ("1000 100000", 1), ("0 0", 8), ("?", 8), (None, 8)],
)
def test_a_quota_of_a_container_limits_the_cores(
    text: str | None, usable: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if text is not None:
        (tmp_path / "cpu.max").write_text(text)
    monkeypatch.setattr(cores, "_CPU_MAX", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(8)), raising=False)
    assert cores.usable_cores() == usable
