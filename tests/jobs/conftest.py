"""The model of the tests of jobs."""

from pathlib import Path

import pytest
from helpers.tiny import write_model

from depthcli.inference.loading import SessionLoader


@pytest.fixture
def loader(tmp_path: Path) -> SessionLoader:
    """The tiny model; modules of plates have one that learned a camera."""
    return SessionLoader(write_model(tmp_path / "model"), "cpu", threads=1)
