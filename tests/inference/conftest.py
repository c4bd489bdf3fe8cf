"""Where the tests of inference add models."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that takes models, one of the test's own."""
    folder = tmp_path / "own"
    monkeypatch.setenv("DEPTHCLI_MODELS", str(folder))
    return folder
