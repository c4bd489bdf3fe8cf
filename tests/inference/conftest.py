"""Where the tests of inference add models."""

from pathlib import Path

import pytest


@pytest.fixture
def models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that takes models, one for each test."""
    folder = tmp_path / "own"
    monkeypatch.setenv("DEPTHCLI_MODELS", str(folder))
    return folder
