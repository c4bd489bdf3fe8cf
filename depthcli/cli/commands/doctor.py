"""``depthcli doctor``: checking the installation."""

import dataclasses

import typer

from depthcli.cli.options import PROVIDERS, JsonOption, models
from depthcli.cli.screen import console
from depthcli.errors import ExitCode


def doctor(
    model: str | None = typer.Option(
        None,
        "--model",
        metavar="MODEL",
        autocompletion=models,
        help="Model to check, by name or path.",
    ),
    provider: str = typer.Option(
        "auto",
        metavar="NAME",
        autocompletion=lambda: PROVIDERS,
        help="Execution provider to check.",
    ),
    as_json: JsonOption = False,
) -> int:
    """Check versions, onnxruntime packages, the provider really active, a model, and codecs.

    Exit code 0 if everything needed works, 3 if something does not.
    """
    from depthcli.jobs.doctor import check_installation

    failed = False
    for check in check_installation(model, provider):
        failed = failed or check.status == "failed"
        text = f"{check.status:<8} {check.name:<24} {check.detail}"
        console.show(dataclasses.asdict(check), text, as_json=as_json)
    return ExitCode.FAILURE if failed else ExitCode.OK
