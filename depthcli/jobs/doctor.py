"""Checking the installation: packages, a model, the providers and the codecs.

No package is imported before its own check, so that a broken package is reported as well.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Literal

from depthcli.errors import DepthcliError

_MODULES = {
    "numpy": ("ndarray", "numpy"),
    "cv2": ("imdecode", "opencv-python-headless"),
    "onnxruntime": ("InferenceSession", "onnxruntime"),
    "OpenEXR": ("File", "OpenEXR"),
    "av": ("VideoFrame", "av"),
}  #: module -> a name that it must have, and the package that provides it


@dataclass(frozen=True, slots=True)
class Check:
    """The result of one check."""

    name: str  #: what was checked
    status: Literal["ok", "warning", "failed"]  #: ``ok``, ``warning`` or ``failed``
    detail: str  #: what was found, one line


def check_installation(model: str | None = None, provider: str = "auto") -> Iterator[Check]:
    """Check versions, packages, a model, the providers and the codecs.

    A provider other than ``auto`` has to work; a model of None is the default model.
    """
    yield from check_versions()
    yield from check_modules()
    yield from check_conflicts()
    checks: dict[str, Callable[[], Iterator[Check]]] = {
        "model": lambda: _check_model(model, provider),
        "providers": lambda: _check_providers(model),
        "codecs": _check_codecs,
        "extras for images": _check_extras,
        "video codecs": _check_video,
    }
    for name, check in checks.items():
        try:
            yield from check()
        except Exception as error:  # noqa: BLE001 - a broken package can raise anything
            yield Check(name, "failed", _one_line_reason(error))


def _tried(name: str, action: Callable[[], object], works: str) -> Check:
    """The check of an action: a warning if it raises an error of depthcli."""
    try:
        action()
    except DepthcliError as error:
        return Check(name, "warning", str(error))
    return Check(name, "ok", works)


def check_versions() -> Iterator[Check]:
    """Compare the installed packages with what depthcli and its extras require."""
    from importlib.metadata import PackageNotFoundError, requires, version

    from packaging.requirements import Requirement

    from depthcli._version import __version__

    yield Check("depthcli", "ok", __version__)
    yield Check("Python", "ok", sys.version.split()[0])
    packages = dict[str, Requirement]()
    for text in requires("depthcli") or ():
        if not text.endswith("extra == 'dev'"):
            packages.setdefault(Requirement(text).name, Requirement(text))
    for name, requirement in packages.items():
        is_needed = not requirement.marker or requirement.marker.evaluate({"extra": ""})
        try:
            installed = version(name)
        except PackageNotFoundError:
            if is_needed:
                yield Check(name, "warning", "not installed under this name")
            continue
        if requirement.specifier.contains(installed, prereleases=True):
            yield Check(name, "ok", installed)
            continue
        mend = f"{installed}; install what is needed: pip install '{name}{requirement.specifier}'"
        yield Check(name, "failed" if is_needed else "warning", mend)


def check_modules() -> Iterator[Check]:
    """Check that each module can be imported and is not empty, as after an interrupted install."""
    for module, (needed, package) in _MODULES.items():
        try:
            getattr(import_module(module), needed)
        except Exception as error:  # noqa: BLE001 - a broken package can raise anything
            mend = f"install it again: pip install --force-reinstall {package}"
            yield Check(f"import {module}", "failed", f"{_one_line_reason(error)}; {mend}")
        else:
            yield Check(f"import {module}", "ok", "imports")


def check_conflicts() -> Iterator[Check]:
    """Check for packages that provide the same module and overwrite each other's files.

    With two onnxruntime packages, GPU support may be lost; with two OpenCV packages, codecs.
    """
    from importlib.metadata import distributions

    for title, prefix, module in (
        ("onnxruntime packages", "onnxruntime", "onnxruntime/__init__.py"),
        ("OpenCV packages", "opencv", "cv2/__init__.py"),
    ):
        named = (dist for dist in distributions() if dist.name.lower().startswith(prefix))
        packages = sorted({dist.name for dist in named if module in map(str, dist.files or ())})
        detail = ", ".join(packages) or "not installed as a package"
        if len(packages) > 1:
            detail += " overwrite each other; uninstall all of them, then install one"
        yield Check(title, "failed" if len(packages) > 1 else "ok", detail)


def _one_line_reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    is_worded = isinstance(error, (ImportError, DepthcliError))
    return text if is_worded else f"{type(error).__name__}: {text}"


def _check_model(name: str | None, provider: str) -> Iterator[Check]:
    from depthcli.inference.loading import SessionLoader
    from depthcli.inference.pipeline import try_session
    from depthcli.inference.session import available_providers, ort

    session = SessionLoader(name, provider).load()
    try_session(session)
    model = session.model
    detail = (
        f"{model.path} (sha256 {model.sha256}) runs on {session.provider}; "
        f"onnxruntime {ort.__version__} has {', '.join(available_providers())}"
    )
    text = "; ".join((detail, *session.warnings))
    yield Check("model", "warning" if session.warnings else "ok", text)


def _check_providers(name: str | None) -> Iterator[Check]:
    """Check that each available provider runs the model, except one that takes minutes."""
    from depthcli.inference.loading import SessionLoader
    from depthcli.inference.pipeline import try_session
    from depthcli.inference.session import SLOW_TO_START, available_providers

    def load_and_run() -> None:
        try_session(SessionLoader(name, provider).load())

    for provider in available_providers():
        title = f"provider {provider}"
        if provider == SLOW_TO_START:
            yield Check(title, "ok", "built in; builds an engine before its first run, not tried")
        else:
            yield _tried(title, load_and_run, "runs the model")


def _check_codecs() -> Iterator[Check]:
    from depthcli.io.images.opencv import IMAGE_SUFFIXES, can_round_trip

    for suffix in IMAGE_SUFFIXES:
        works = can_round_trip(suffix)
        detail = "reads and writes" if works else "not in this OpenCV; convert such images"
        yield Check(f"codec {suffix}", "ok" if works else "warning", detail)


def _check_extras() -> Iterator[Check]:
    from depthcli.io.media import EXTRAS, is_installed

    for suffix in (".heic", ".dpx"):
        package, install = EXTRAS[suffix]
        version = import_module(package).__version__ if is_installed(package) else None
        text = f"{package} {version}" if version else f"not read; {install}"
        yield Check(f"codec {suffix}", "ok", text)


def _check_video() -> Iterator[Check]:
    from depthcli.video.formats import ENCODINGS, check_encoder

    for codec in ENCODINGS:
        yield _tried(f"video codec {codec}", partial(check_encoder, codec), "writes")
