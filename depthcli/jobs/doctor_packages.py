"""The packages that depthcli stands on: their versions, whether they import, which ones collide."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

_PACKAGES = ("numpy", "opencv-python-headless", "OpenEXR", "av", "typer", "rich", "torch", "onnx")
_OPTIONAL = {"torch", "onnx"}
_BUILDS = {
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
"""What has to be in each module, and the package that brings it."""


@dataclass(frozen=True, slots=True)
class Check:
    """One finding."""

    name: str  #: what was looked at
    status: Literal["ok", "warning", "failed"]  #: ``ok``, ``warning`` or ``failed``
    detail: str  #: what was found, one line


def check_versions() -> Iterator[Check]:
    """Of depthcli, Python and the packages, as they were installed."""
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
    """Whether each module imports and is whole: an install that broke off leaves empty ones."""
    from importlib import import_module

    for module, (needed, package) in _MODULES.items():
        try:
            getattr(import_module(module), needed)
        except Exception as error:  # noqa: BLE001 - a broken package raises whatever it likes
            mend = f"install it again: pip install --force-reinstall {package}"
            yield Check(f"import {module}", "failed", f"{one_line_reason(error)}; {mend}")
        else:
            yield Check(f"import {module}", "ok", "imports")


def one_line_reason(error: Exception) -> str:
    """An error in one line."""
    text = " ".join(str(error).split())
    return text if isinstance(error, ImportError) else f"{type(error).__name__}: {text}"


def check_families() -> Iterator[Check]:
    """Packages that hold the same module overwrite each other's files, whichever comes last.

    Of two onnxruntime packages, the GPU is silently lost; of two OpenCV packages, a codec.
    """
    from importlib.metadata import distributions

    names = {str(dist.metadata["Name"]).lower().replace("_", "-") for dist in distributions()}
    for title, module in (("onnxruntime packages", "onnxruntime"), ("OpenCV packages", "opencv")):
        found = sorted(name for name in names if _holds(module, name))
        detail = ", ".join(found) or "not installed as a package"
        if len(found) < 2:  # noqa: PLR2004 - two are a conflict
            yield Check(title, "ok", detail)
            continue
        advice = "overwrite each other; uninstall all of them, then install one"
        yield Check(title, "failed", f"{detail} {advice}")


def _holds(module: str, package: str) -> bool:
    """Whether a package brings this module: the plain one or a build of it."""
    if module == "opencv":
        return package.startswith(("opencv-python", "opencv-contrib-python"))
    return package == module or (
        package.startswith(f"{module}-") and package.removeprefix(f"{module}-") in _BUILDS
    )
