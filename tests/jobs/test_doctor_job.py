"""Checks of the installation."""

import importlib.metadata
import platform
import sys
from collections.abc import Iterator
from pathlib import Path

import av
import pytest

from depthcli.inference import session
from depthcli.inference.loading import SessionLoader
from depthcli.inference.session import Session
from depthcli.io.images import opencv as codecs
from depthcli.jobs.doctor import Check, check_conflicts, check_installation, check_versions


def by_name(checks: Iterator[Check]) -> dict[str, Check]:
    return {check.name: check for check in checks}


def test_a_broken_model_is_found_and_the_rest_goes_on(models: Path) -> None:
    (models / "default" / "model.onnx").write_bytes(b"broken")
    checks = by_name(check_installation())
    assert checks["model"].status == "failed"
    assert checks["codec .png"].status == "ok"


@pytest.mark.usefixtures("models")
def test_unexpected_error_of_a_check_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_suffix: str) -> bool:
        raise ValueError("of two\nlines")

    monkeypatch.setattr(codecs, "can_round_trip", broken)
    checks = by_name(check_installation())
    assert checks["codecs"] == Check("codecs", "failed", "ValueError: of two lines")
    assert checks["import OpenEXR"].status == "ok"


@pytest.mark.parametrize(
    ("names", "file", "title"),
    [
        (("onnxruntime", "onnxruntime-gpu"), "onnxruntime/__init__.py", "onnxruntime packages"),
        (("opencv-python", "opencv-python-headless"), "cv2/__init__.py", "OpenCV packages"),
    ],
)
def test_two_packages_of_one_module_are_a_conflict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...], file: str, title: str
) -> None:
    seem_installed(tmp_path, monkeypatch, *names, file=file)
    conflict = by_name(check_conflicts())[title]
    assert conflict.status == "failed"
    assert ", ".join(names) in conflict.detail


def test_onnxruntime_add_ons_do_not_clash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seem_installed(tmp_path, monkeypatch, "onnxruntime-extensions", file="other/__init__.py")
    assert by_name(check_conflicts())["onnxruntime packages"].status == "ok"


def test_packages_are_compared_with_what_is_required(monkeypatch: pytest.MonkeyPatch) -> None:
    versions = {"numpy": "1.26.4", "rich": "99.0", "torch": "1.0"}

    def version(package: str) -> str:
        if package in versions:
            return versions[package]
        raise importlib.metadata.PackageNotFoundError

    monkeypatch.setattr(importlib.metadata, "version", version)
    checks = by_name(check_versions())
    assert checks["numpy"].status == "failed"
    assert checks["numpy"].detail.endswith("pip install 'numpy>=2.0'")
    assert checks["rich"] == Check("rich", "ok", "99.0")
    assert checks["av"] == Check("av", "warning", "not installed under this name")
    assert checks["torch"].status == "warning"
    assert "timm" not in checks
    assert checks["Python"].detail == platform.python_version()


@pytest.mark.usefixtures("models")
@pytest.mark.filterwarnings("ignore:Specified provider")
def test_partly_working_provider_or_codec_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "available_providers", lambda: ("tensorrt", "rocm", "cpu"))
    monkeypatch.setattr(codecs, "can_round_trip", lambda suffix: suffix != ".webp")
    load = SessionLoader.load

    def settled(self: SessionLoader) -> Session:
        session = load(self)
        session.warnings = ("runs on cpu",)
        return session

    monkeypatch.setattr(SessionLoader, "load", settled)
    checks = by_name(check_installation())
    assert checks["model"].status == "warning"
    assert checks["model"].detail.endswith("has tensorrt, rocm, cpu; runs on cpu")
    assert (checks["provider tensorrt"].status, checks["provider cpu"].status) == ("ok", "ok")
    assert "not tried" in checks["provider tensorrt"].detail
    assert checks["provider rocm"].status == "warning"
    assert (checks["codec .webp"].status, checks["codec .png"].status) == ("warning", "ok")


@pytest.mark.usefixtures("models")
def test_a_video_codec_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(av, "codecs_available", av.codecs_available - {"libx264"})
    checks = by_name(check_installation())
    assert checks["video codec ffv1"] == Check("video codec ffv1", "ok", "writes")
    assert checks["video codec h264"].status == "warning"
    assert "no libx264" in checks["video codec h264"].detail


@pytest.mark.usefixtures("models")
def test_the_decoder_of_heic_is_named_or_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pillow_heif", reason="HEIC needs pillow-heif")
    assert by_name(check_installation())["codec .heic"].detail.startswith("pillow_heif 1.")
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    assert by_name(check_installation())["extras for images"].status == "failed"


def seem_installed(folder: Path, monkeypatch: pytest.MonkeyPatch, *names: str, file: str) -> None:
    for name in names:
        about = folder / f"{name}-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (about / "RECORD").write_text(f"{file},,\n")
    (folder / file).parent.mkdir()
    (folder / file).touch()  # files that are missing are not listed by Python 3.12
    monkeypatch.syspath_prepend(folder)
