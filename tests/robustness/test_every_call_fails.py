"""A sample of ``every_call_fails.py``, which tries every call of every command."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import ROOT, unmeasured

COMMAND = Path(__file__).with_name("every_call_fails.py")


@pytest.mark.skipif(
    sys.platform != "linux" or not shutil.which("cc"), reason="compiles a library to preload"
)
def test_a_call_that_fails_costs_no_half_file_and_is_told() -> None:
    """Writes, as the formats' own libraries and not only Python make them."""
    names = ("predict", "profile save --force")
    done = subprocess.run(
        [sys.executable, COMMAND, *names, "--calls", "write", "--errors", "ENOSPC"],
        env={**unmeasured(), "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith("0 fell short\n")
    assert all(f"{name}: 0 faults" not in done.stdout for name in names)
