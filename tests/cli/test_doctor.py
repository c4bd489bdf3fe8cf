"""``depthcli doctor``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from command_line import Cli


def checks(stdout: bytes) -> dict[str, dict[str, str]]:
    return {check["name"]: check for check in map(json.loads, stdout.splitlines())}


def test_all_is_well(cli: Cli) -> None:
    done = cli("doctor", "--json", "--provider", "cpu")
    found = checks(done.stdout)
    assert done.returncode == 0
    assert found["model"]["status"] == "ok"
    assert "runs on cpu" in found["model"]["detail"]
    assert found["codec .png"]["status"] == found["codec .exr"]["status"] == "ok"
    assert found["numpy"]["detail"]


def test_a_broken_model_is_found_and_the_rest_goes_on(cli: Cli) -> None:
    (cli.models / "default" / "model.onnx").write_bytes(b"broken")
    done = cli("doctor", "--json")
    found = checks(done.stdout)
    assert done.returncode == 3
    assert found["model"]["status"] == "failed"
    assert "codec .png" in found


def test_two_onnxruntime_packages_are_a_conflict(cli: Cli) -> None:
    for name in ("onnxruntime", "onnxruntime_gpu"):
        folder = cli.folder / f"{name}-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    done = cli("doctor", "--json", PYTHONPATH=f"{cli.site}:{cli.folder}")
    conflict = checks(done.stdout)["onnxruntime packages"]
    assert done.returncode == 3
    assert conflict["status"] == "failed"
    assert "onnxruntime, onnxruntime-gpu" in conflict["detail"]


def test_text_is_one_line_a_check(cli: Cli) -> None:
    lines = cli("doctor").stdout.decode().splitlines()
    assert all(line.split()[0] in {"ok", "warning", "failed"} for line in lines)


def installed_as(cli: Cli, *names: str) -> str:
    """A folder on the path in which these packages seem to be installed."""
    for name in names:
        folder = cli.folder / f"{name}-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    return f"{cli.site}:{cli.folder}"


def test_two_opencv_packages_are_a_conflict(cli: Cli) -> None:
    path = installed_as(cli, "opencv_python", "opencv_python_headless")
    done = cli("doctor", "--json", PYTHONPATH=path)
    conflict = checks(done.stdout)["OpenCV packages"]
    assert done.returncode == 3
    assert conflict["status"] == "failed"
    assert "opencv-python, opencv-python-headless" in conflict["detail"]


def test_add_ons_of_onnxruntime_are_no_conflict(cli: Cli) -> None:
    path = installed_as(cli, "onnxruntime_extensions", "onnxruntime_genai")
    found = checks(cli("doctor", "--json", PYTHONPATH=path).stdout)
    assert found["onnxruntime packages"]["status"] == "ok"


def test_each_provider_is_tried(cli: Cli) -> None:
    found = checks(cli("doctor", "--json").stdout)
    assert found["provider cpu"] == {
        "name": "provider cpu",
        "status": "ok",
        "detail": "runs the model",
    }


def test_a_provider_that_is_not_there_fails(cli: Cli) -> None:
    done = cli("doctor", "--json", "--provider", "openvino")
    model = checks(done.stdout)["model"]
    if model["status"] == "ok":
        assert "runs on openvino" in model["detail"]
    else:
        assert done.returncode == 3
        assert "openvino" in model["detail"]


BROKEN = {
    "raises": "raise ImportError('libGL.so.1: cannot open shared object file\\nno such file')",
    "empty": "",
    "fails otherwise": "raise RuntimeError('built for another NumPy')",
}


@pytest.mark.parametrize("how", BROKEN)
@pytest.mark.parametrize(
    ("module", "package"), [("cv2", "opencv-python-headless"), ("onnxruntime", "onnxruntime")]
)
def test_a_broken_package_is_a_finding(cli: Cli, module: str, package: str, how: str) -> None:
    broken = cli.folder / "broken" / module
    broken.mkdir(parents=True)
    (broken / "__init__.py").write_text(BROKEN[how])
    done = cli("doctor", "--json", PYTHONPATH=f"{broken.parent}:{cli.site}")
    found = checks(done.stdout)
    assert (done.returncode, done.stderr) == (3, b"")
    assert found[f"import {module}"]["status"] == "failed"
    assert f"pip install --force-reinstall {package}" in found[f"import {module}"]["detail"]
    assert all("\n" not in check["detail"] for check in found.values())
    assert found["import numpy"]["status"] == found["codec .exr"]["status"] == "ok"
    other = "codec .png" if module == "onnxruntime" else "import onnxruntime"
    assert found[other]["status"] == "ok"


def test_without_numpy_there_is_still_a_report(cli: Cli) -> None:
    broken = cli.folder / "broken" / "numpy"
    broken.mkdir(parents=True)
    (broken / "__init__.py").write_text("raise ImportError('numpy C-extensions failed')")
    done = cli("doctor", PYTHONPATH=f"{broken.parent}:{cli.site}")
    lines = done.stdout.decode().splitlines()
    assert done.returncode == 3
    assert any(line.startswith("failed   import numpy") for line in lines)
    assert lines[-1].split()[0] == "failed"
