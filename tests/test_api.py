"""The Python API: every public name is there, and none costs anything before it is used."""

import subprocess
import sys

import pytest

import depthcli


@pytest.mark.parametrize("name", depthcli.__all__)
def test_every_public_name_resolves(name: str) -> None:
    assert getattr(depthcli, name) is not None
    assert name in dir(depthcli)


def test_another_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        depthcli.nonsense  # noqa: B018 - looking is the test


def test_every_error_is_public() -> None:
    from depthcli import errors  # noqa: PLC0415

    names = {name for name in vars(errors) if name.endswith("Error")}
    assert names <= set(depthcli.__all__)


def test_import_alone_is_light() -> None:
    code = (
        "import sys, depthcli; assert not {'av', 'numpy', 'cv2', 'onnxruntime'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
