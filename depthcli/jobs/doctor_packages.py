"""Checking the packages that depthcli depends on: versions, imports, conflicts."""

import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

_OPTIONAL = ("pillow-heif", "torch", "onnx")
_FASTER_PNG = ("deflate",) if platform.machine() in {"x86_64", "AMD64", "arm64", "aarch64"} else ()
_PACKAGES = (
    *("numpy", "opencv-python-headless", "OpenEXR", "av", "typer", "rich"),
    *(*_FASTER_PNG, *_OPTIONAL),
)
_ONNXRUNTIME_BUILDS = {
    *("gpu", "directml", "openvino", "rocm", "migraphx"),
    *("training", "silicon", "qnn", "gpu-cu12"),
}
_MODULES = {
    "numpy": ("ndarray", "numpy"),
    "cv2": ("imdecode", "opencv-python-headless"),
    "onnxruntime": ("InferenceSession", "onnxruntime"),
    "OpenEXR": ("File", "OpenEXR"),
    "av": ("VideoFrame", "av"),
}
"""Module -> a name that it must have, and the package that provides it."""


@dataclass(frozen=True, slots=True)
class Check:
    """The result of one check."""

    name: str  #: what was checked
    status: Literal["ok", "warning", "failed"]  #: ``ok``, ``warning`` or ``failed``
    detail: str  #: what was found, one line


def check_versions() -> Iterator[Check]:
    """Report the installed versions of depthcli, Python and the packages."""
    from importlib.metadata import PackageNotFoundError, version

    from depthcli._version import __version__

    yield Check("depthcli", "ok", __version__)
    yield Check("Python", "ok", sys.version.split()[0])
    for package in _PACKAGES:
        try:
            yield Check(package, "ok", version(package))
        except PackageNotFoundError:
            if package not in _OPTIONAL:
                yield Check(package, "warning", "not installed under this name")


def check_modules() -> Iterator[Check]:
    """Check that each module can be imported and is not empty, as after an interrupted install."""
    from importlib import import_module

    for module, (needed, package) in _MODULES.items():
        try:
            getattr(import_module(module), needed)
        except Exception as error:  # noqa: BLE001 - a broken package can raise anything
            mend = f"install it again: pip install --force-reinstall {package}"
            yield Check(f"import {module}", "failed", f"{one_line_reason(error)}; {mend}")
        else:
            yield Check(f"import {module}", "ok", "imports")


def one_line_reason(error: Exception) -> str:
    """An error in one line."""
    text = " ".join(str(error).split())
    return text if isinstance(error, ImportError) else f"{type(error).__name__}: {text}"


def check_conflicts() -> Iterator[Check]:
    """Check for packages that provide the same module and overwrite each other's files.

    With two onnxruntime packages, GPU support may be lost; with two OpenCV packages, codecs.
    """
    from importlib.metadata import distributions

    names = {str(dist.metadata["Name"]).lower().replace("_", "-") for dist in distributions()}
    for title, module in (("onnxruntime packages", "onnxruntime"), ("OpenCV packages", "opencv")):
        found = sorted(name for name in names if _provides(module, name))
        detail = ", ".join(found) or "not installed as a package"
        if len(found) < 2:  # noqa: PLR2004 - two are a conflict
            yield Check(title, "ok", detail)
            continue
        advice = "overwrite each other; uninstall all of them, then install one"
        yield Check(title, "failed", f"{detail} {advice}")


def _provides(module: str, package: str) -> bool:
    """Whether a package provides this module: the plain package or another build of it."""
    if module == "opencv":
        return package.startswith(("opencv-python", "opencv-contrib-python"))
    return package == module or (
        package.startswith(f"{module}-")
        and package.removeprefix(f"{module}-") in _ONNXRUNTIME_BUILDS
    )
