"""``depthcli doctor``: what works on this machine, and what does not."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from depthcli.cli import console
from depthcli.errors import DepthcliError, ExitCode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

app = typer.Typer(rich_markup_mode=None)

_PACKAGES = ("numpy", "opencv-python-headless", "OpenEXR", "typer", "rich", "torch", "onnx")
_OPTIONAL = {"torch", "onnx"}
_BUILDS = {
    "gpu",
    "directml",
    "openvino",
    "rocm",
    "migraphx",
    "training",
    "silicon",
    "qnn",
    "gpu-cu12",
}


class Check(NamedTuple):
    """One finding.

    Attributes:
        name: what was looked at.
        status: ``ok``, ``warning`` or ``failed``.
        detail: what was found, one line.
    """

    name: str
    status: str
    detail: str


@app.command()
def doctor(
    model: Annotated[str | None, typer.Option(help="Name or path of a model to check.")] = None,
    provider: Annotated[str, typer.Option(help="Provider to start the model on.")] = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
) -> int:
    """Check versions, onnxruntime packages, the provider really active, a model, and codecs.

    Exit code 0 if everything needed works, 3 if something does not.
    """
    failed = False
    for check in _checks(model, provider):
        failed = failed or check.status == "failed"
        if as_json:
            console.out_json(check._asdict())
        else:
            console.out(f"{check.status:<8} {check.name:<24} {console.one_line(check.detail)}")
    return ExitCode.FAILURE if failed else ExitCode.OK


def _checks(model: str | None, provider: str) -> Iterator[Check]:
    yield from _versions()
    yield from _families()
    yield _guarded("model", lambda: _model(model, provider))
    yield from _providers(model)
    yield from _codecs()
    yield _guarded("codec .exr", _exr)


def _versions() -> Iterator[Check]:
    from importlib.metadata import PackageNotFoundError, version

    from depthcli import __version__

    yield Check("depthcli", "ok", __version__)
    yield Check("Python", "ok", sys.version.split()[0])
    for package in _PACKAGES:
        try:
            yield Check(package, "ok", version(package))
        except PackageNotFoundError:
            if package not in _OPTIONAL:
                yield Check(package, "warning", "not installed under this name")


def _families() -> Iterator[Check]:
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


def _model(name: str | None, provider: str) -> Check:
    import onnxruntime

    from depthcli.inference.catalog import find_model
    from depthcli.inference.providers import available_providers
    from depthcli.inference.trial import try_model

    model = find_model(name)
    session = try_model(model, provider=provider)
    detail = (
        f"{model.path} (sha256 {model.sha256}) runs on {session.provider}; "
        f"onnxruntime {onnxruntime.__version__} has {', '.join(available_providers())}"
    )
    status = "warning" if session.warnings else "ok"
    return Check("model", status, "; ".join((detail, *session.warnings)))


def _providers(name: str | None) -> Iterator[Check]:
    """Whether each provider of this onnxruntime runs the model, but for one that takes minutes."""
    from depthcli.inference.catalog import find_model
    from depthcli.inference.providers import SLOW_TO_START, available_providers
    from depthcli.inference.trial import try_model

    for provider in available_providers():
        title = f"provider {provider}"
        if provider == SLOW_TO_START:
            yield Check(title, "ok", "built in; builds an engine before its first run, not tried")
            continue
        try:
            try_model(find_model(name), provider=provider)
        except DepthcliError as error:
            yield Check(title, "warning", str(error))
        else:
            yield Check(title, "ok", "runs the model")


def _codecs() -> Iterator[Check]:
    from depthcli.io.codecs import PICTURE_SUFFIXES, can_code

    for suffix in PICTURE_SUFFIXES:
        works = can_code(suffix)
        detail = "reads and writes" if works else "not in this OpenCV; convert such pictures"
        yield Check(f"codec {suffix}", "ok" if works else "warning", detail)


def _exr() -> Check:
    import OpenEXR

    return Check("codec .exr", "ok", f"OpenEXR {OpenEXR.__version__}")


def _guarded(name: str, check: Callable[[], Check]) -> Check:
    """A check that turns an error into a finding: one problem never hides the others."""
    try:
        return check()
    except (DepthcliError, ImportError, OSError) as error:
        return Check(name, "failed", str(error))
