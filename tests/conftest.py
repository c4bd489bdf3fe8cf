"""What several test files share: a tiny model, an image, the command line of the built wheel."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from helpers.command_line import ROOT, Cli, InProcess
from helpers.tiny import write_image, write_model
from hypothesis import HealthCheck, settings

from depthcli.io.media import is_installed
from depthcli.io.storage import objects

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from helpers.stores import Bucket, Faults

WORKER = os.environ.get("PYTEST_XDIST_WORKER")
"""Name of this one of several test processes; None where there is one."""
if WORKER:
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # the processes share the cores already

# How long an example takes says nothing about what is tested, least of all on a busy machine. The
# same examples every time, so that a change fails for what it does; others by
# ``--hypothesis-profile=random``.
settings.register_profile("random", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("same", settings.get_profile("random"), derandomize=True)
settings.load_profile("same")

# A shell that starts the tests in the background lets them, and all that they start, ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup, too, would have it ignored


@pytest.fixture
def model_folder(tmp_path: Path) -> Path:
    """A folder with the tiny model."""
    return write_model(tmp_path / "tiny")


@pytest.fixture
def models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A catalog whose default model is the tiny one."""
    write_model(tmp_path / "models" / "default")
    monkeypatch.setenv("DEPTHCLI_MODELS", str(tmp_path / "models"))
    return tmp_path / "models"


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """The synthetic image as a PNG in a folder of its own."""
    return write_image(tmp_path / "images" / "room.png")


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the built wheel installed in it, and nothing else, for all test processes."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if WORKER else base) / "wheel"
    folder.mkdir(exist_ok=True)
    target = folder / "site"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # the others wait until it is there
        if not target.exists():
            _install(folder, target)
    return target


def _install(folder: Path, target: Path) -> None:
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder)]
    _checked([*build, str(ROOT)])
    (wheel,) = folder.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    _checked([*pip, "--target", str(target), str(wheel)])


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


@pytest.fixture
def without_heif(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As if pillow-heif were not installed."""
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    is_installed.cache_clear()
    yield
    is_installed.cache_clear()


@pytest.fixture(scope="session")
def s3_endpoint() -> Iterator[str]:
    """Address of an S3 server on this machine."""
    from helpers.stores import s3_server  # noqa: PLC0415 - it takes a second to load

    with s3_server() as endpoint:
        yield endpoint


@pytest.fixture
def bucket(s3_endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Bucket:
    """An empty bucket, which this process and those that it starts can use."""
    from helpers.stores import KEYS, REGION, Bucket  # noqa: PLC0415

    for name, value in {**KEYS, "AWS_DEFAULT_REGION": REGION, "DEPTHCLI_RETRIES": "4"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_ENDPOINT_URL", s3_endpoint)
    objects._store.cache_clear()
    return Bucket(s3_endpoint, f"bucket-{os.urandom(4).hex()}")


@pytest.fixture
def faults(bucket: Bucket, monkeypatch: pytest.MonkeyPatch) -> Iterator[Faults]:
    """A way to the bucket's server that can be made to fail; it is the one that is used."""
    from helpers.stores import Faults  # noqa: PLC0415

    with Faults(bucket.endpoint) as proxy:
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.endpoint)
        yield proxy


@pytest.fixture
def once_each(faults: Faults) -> Callable[[], Faults]:
    """Every object's requests fail once in one way and once in another."""
    kinds = ("503 SlowDown", "cut", "drop", "500 InternalError")

    def fault(_method: str, path: str, before: int) -> str | None:
        return kinds[(before + len(path)) % len(kinds)] if before < 2 else None

    def begin() -> Faults:
        faults.fault = fault
        return faults

    return begin
