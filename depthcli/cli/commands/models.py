"""``depthcli models``: listing, inspecting, verifying, adding and removing models."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.arguments import completion
from depthcli.cli.arguments.options import JsonOutputOption
from depthcli.cli.commands import models_added
from depthcli.cli.screen import console
from depthcli.core.text import one_line
from depthcli.errors import DepthcliError, ExitCode

if TYPE_CHECKING:
    from depthcli.jobs.verify_models import ModelCheck
    from depthcli.models.card import ModelCard
    from depthcli.models.locations import ModelLocation

app = typer.Typer(
    rich_markup_mode=None,
    invoke_without_command=True,
    help="List, inspect, verify, add and remove models.",
)

_Name = Annotated[
    str,
    typer.Argument(
        autocompletion=completion.models_and_cards,
        help="Model name, .onnx file, folder with a card.json, or name of a ready card.",
    ),
]


app.command("add")(models_added.add_model_file)
app.command("remove")(models_added.remove_models)
app.command("cards")(models_added.list_cards)


@app.callback()
def _models_group(context: typer.Context) -> None:
    """The models that are bundled or installed; without a command, their list."""
    if context.invoked_subcommand is None:
        list_models()


@app.command("list")
def list_models(as_json: JsonOutputOption = False) -> int:
    """List the models available by name.

    Search order: folders in DEPTHCLI_MODELS, models added with 'depthcli models add', bundled
    models.
    """
    from depthcli.models.locations import list_locations

    found = [(name, place, _card_or_error(place)) for name, place in list_locations()]
    if as_json:
        for name, place, card in found:
            console.out_json(_model_json(name, place, card))
    else:
        rows = [_model_row(name, place, card) for name, place, card in found]
        console.print_table(("name", "version", "kind", "size", "summary", "path"), rows)
    broken = any(isinstance(card, DepthcliError) for _, _, card in found)
    return ExitCode.FAILURE if broken else ExitCode.OK


@app.command("show")
def show_model(model: _Name = "default") -> int:
    """Show a model's card, or a ready card, as JSON."""
    from depthcli.models.catalog import find_model
    from depthcli.models.locations import list_locations
    from depthcli.models.ready_cards import ready_fields, ready_names

    if model in ready_names() and model not in dict(list_locations()):
        console.out(json.dumps(ready_fields(model), indent=2, ensure_ascii=False))
    else:
        console.out(find_model(model).card.to_json().rstrip())
    return ExitCode.OK


@app.command()
def verify(
    models: Annotated[
        list[str] | None,
        typer.Argument(
            autocompletion=completion.models,
            help="Model names or paths. Default: all listed models.",
        ),
    ] = None,
    as_json: JsonOutputOption = False,
) -> int:
    """Verify size, checksum and card, and run each model once."""
    from depthcli.jobs.verify_models import verify_models

    failed = False
    for check in verify_models(models or ()):
        failed = failed or isinstance(check.found, DepthcliError)
        _print_check(check, as_json=as_json)
    return ExitCode.FAILURE if failed else ExitCode.OK


def _print_check(check: ModelCheck, *, as_json: bool) -> None:
    name, found = check.name, check.found
    if isinstance(found, DepthcliError):
        if as_json:
            console.out_json({"name": name, "status": "failed", "error": str(found)})
        else:
            console.error(str(found))
    elif as_json:
        facts = {"path": str(found.path), "sha256": found.sha256, "bytes": len(found.data)}
        console.out_json({"name": name, "status": "ok", **facts})
    else:
        console.out(f"{one_line(name)}: ok, sha256 {found.sha256}")


def _card_or_error(place: ModelLocation) -> ModelCard | DepthcliError:
    from depthcli.models.catalog import read_model

    try:
        return read_model(place).card
    except DepthcliError as error:
        return error


def _model_json(
    name: str, place: ModelLocation, card: ModelCard | DepthcliError
) -> dict[str, object]:
    if isinstance(card, DepthcliError):
        return {"name": name, "path": str(place.path), "status": "failed", "error": str(card)}
    return {
        "name": name,
        "path": str(place.path),
        "status": "ok",
        "version": card.version,
        "kind": card.output.kind.value,
        "bytes": card.size_bytes,
        "sha256": card.sha256,
        "summary": card.summary,
        "license": card.license,
    }


def _model_row(name: str, place: ModelLocation, card: ModelCard | DepthcliError) -> tuple[str, ...]:
    if isinstance(card, DepthcliError):
        return (name, "", "damaged", "", str(card), str(place.path))
    size = "" if card.size_bytes is None else f"{card.size_bytes / 1e6:.1f} MB"
    return (name, card.version, card.output.kind, size, card.summary, str(place.path))
