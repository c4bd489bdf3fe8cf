"""What several test files share: a tiny model, a picture, the command line of the built wheel."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from command_line import ROOT, Cli, InProcess
from hypothesis import HealthCheck, settings
from tiny import write_model, write_picture

if TYPE_CHECKING:
    from pathlib import Path

# How long an example takes says nothing about what is tested, least of all on a busy machine.
settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")

# A shell that starts the tests in the background lets them, and all that they start, ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup, too, would have it ignored


@pytest.fixture
def model_folder(tmp_path: Path) -> Path:
    """A folder with the tiny model."""
    return write_model(tmp_path / "tiny")


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """The synthetic picture as a PNG in a folder of its own."""
    return write_picture(tmp_path / "pictures" / "room.png")


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the built wheel installed in it, and nothing else."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder)]
    _checked([*build, str(ROOT)])
    (wheel,) = folder.glob("*.whl")
    target = folder / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    _checked([*pip, "--target", str(target), str(wheel)])
    return target


def _checked(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{command}: {done.stdout}{done.stderr}")


@pytest.fixture
def cli(installed: Path, tmp_path: Path) -> Cli:
    """The installed command line in an empty folder."""
    return _in_a_folder(Cli, installed, tmp_path)


@pytest.fixture
def inside(tmp_path: Path) -> Cli:
    """The source's command line in an empty folder, without a process of its own."""
    return _in_a_folder(InProcess, ROOT, tmp_path)


def _in_a_folder(kind: type[Cli], site: Path, tmp_path: Path) -> Cli:
    folder, models = tmp_path / "work", tmp_path / "models"
    folder.mkdir(exist_ok=True)  # a test may have both
    write_model(models / "default")
    return kind(site, folder, models)
