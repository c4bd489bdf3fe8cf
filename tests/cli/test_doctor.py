"""``depthcli doctor``."""

import json

import pytest
from helpers.command_line import Cli


def checks(stdout: bytes) -> dict[str, dict[str, str]]:
    return {check["name"]: check for check in map(json.loads, stdout.splitlines())}


def test_all_is_well(cli: Cli) -> None:
    done = cli("doctor", "--json", "--provider", "cpu")
    found = checks(done.stdout)
    assert done.returncode == 0
    assert found["model"]["status"] == "ok"
    assert "runs on cpu" in found["model"]["detail"]
    assert found["codec .png"]["status"] == found["import OpenEXR"]["status"] == "ok"
    assert found["numpy"]["detail"]


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
    assert found["import numpy"]["status"] == found["import OpenEXR"]["status"] == "ok"
    other = "codec .png" if module == "onnxruntime" else "import onnxruntime"
    assert found[other]["status"] == "ok"
