"""``depthcli doctor``: what works on this machine, and what does not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.arguments import completion
from depthcli.cli.screen import console
from depthcli.core.text import one_line
from depthcli.errors import DepthcliError, ExitCode
from depthcli.jobs.doctor_packages import Check, families, modules, reason, versions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

app = typer.Typer(rich_markup_mode=None)


@app.command()
def doctor(
    model: Annotated[
        str | None,
        typer.Option(autocompletion=completion.models, help="Model to check, by name or path."),
    ] = None,
    provider: Annotated[
        str,
        typer.Option(autocompletion=completion.providers, help="Execution provider to check."),
    ] = "auto",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object per line.")
    ] = False,
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
            console.out(f"{check.status:<8} {check.name:<24} {one_line(check.detail)}")
    return ExitCode.FAILURE if failed else ExitCode.OK


def _checks(model: str | None, provider: str) -> Iterator[Check]:
    yield from versions()
    yield from modules()
    yield from families()
    yield from _guarded("model", lambda: _model(model, provider))
    yield from _guarded("providers", lambda: _providers(model))
    yield from _guarded("codecs", _codecs)
    yield from _guarded("codec .exr", _exr)


def _model(name: str | None, provider: str) -> Iterator[Check]:
    import onnxruntime

    from depthcli.inference.providers import available_providers
    from depthcli.inference.trial import try_model
    from depthcli.models.catalog import find_model

    model = find_model(name)
    session = try_model(model, provider=provider)
    detail = (
        f"{model.path} (sha256 {model.sha256}) runs on {session.provider}; "
        f"onnxruntime {onnxruntime.__version__} has {', '.join(available_providers())}"
    )
    status = "warning" if session.warnings else "ok"
    yield Check("model", status, "; ".join((detail, *session.warnings)))


def _providers(name: str | None) -> Iterator[Check]:
    """Whether each provider of this onnxruntime runs the model, but for one that takes minutes."""
    from depthcli.inference.providers import SLOW_TO_START, available_providers
    from depthcli.inference.trial import try_model
    from depthcli.models.catalog import find_model

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
    from depthcli.io.pictures.codecs import PICTURE_SUFFIXES, can_code

    for suffix in PICTURE_SUFFIXES:
        works = can_code(suffix)
        detail = "reads and writes" if works else "not in this OpenCV; convert such pictures"
        yield Check(f"codec {suffix}", "ok" if works else "warning", detail)


def _exr() -> Iterator[Check]:
    import OpenEXR

    yield Check("codec .exr", "ok", f"OpenEXR {OpenEXR.__version__}")


def _guarded(name: str, checks: Callable[[], Iterator[Check]]) -> Iterator[Check]:
    """Checks whose error is a finding too: one problem never hides the others."""
    try:
        yield from checks()
    except DepthcliError as error:
        yield Check(name, "failed", str(error))
    except Exception as error:  # noqa: BLE001 - a broken package raises whatever it likes
        yield Check(name, "failed", reason(error))
