"""``depthcli models``: listing, inspecting, verifying, adding and removing models."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli import completion
from depthcli.cli.options import JsonOption, QuietOption
from depthcli.cli.screen import console
from depthcli.core.options import one_line
from depthcli.errors import DepthcliError, ExitCode

if TYPE_CHECKING:
    from depthcli.jobs.models import ModelCheck
    from depthcli.models.card import ModelCard
    from depthcli.models.catalog import ModelLocation


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


@app.command("add")
def add_model_file(
    file: str = typer.Argument(
        ..., metavar="FILE", help="ONNX file with embedded weights, or its URL."
    ),
    card: str | None = typer.Option(
        None,
        "--card",
        metavar="CARD",
        autocompletion=completion.cards,
        help="A card.json, or the name of a ready card ('depthcli models cards'). Default: "
        "the card in the file, or next to one on this machine.",
    ),
    name: str | None = typer.Option(
        None, "--name", metavar="NAME", help="Name for --model. Default: the name in the card."
    ),
    force: bool = typer.Option(
        False, "--force", help="Replace an existing model of this name, or override a bundled one."
    ),
    sha256: str | None = typer.Option(
        None, metavar="HEX", help="SHA-256 checksum that the file must have."
    ),
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> int:
    """Add an ONNX model after checking its card.

    Copies the file to the first folder in DEPTHCLI_MODELS, else to depthcli/models in the user's
    data folder, after running the model once.
    """
    from depthcli.cli.screen.progress import show_progress
    from depthcli.io.storage.paths import is_remote, path_of
    from depthcli.jobs.models import add_model

    with show_progress(silent=as_json or quiet) as progress:
        model = add_model(
            path_of(file), card, name=name, force=force, sha256=sha256, progress=progress
        )
    if as_json:
        console.out_json(
            {"name": model.card.name, "path": str(model.path.parent), "sha256": model.sha256}
            | _preprocessing_json(model.card)
        )
        return ExitCode.OK
    if quiet:
        return ExitCode.OK
    added = f"{model.card.name}: {output_text(model.card)}, in {model.path.parent}"
    console.report(one_line(added))
    if is_remote(file) and sha256 is None:
        console.note(f"to get exactly this file again: --sha256 {model.sha256}")
    _warn_of_preprocessing(model.card)
    return ExitCode.OK


@app.command("remove")
def remove_models(
    models: list[str] = typer.Argument(
        ...,
        metavar="NAME...",
        autocompletion=completion.added_models,
        help="Names of added models.",
    ),
) -> int:
    """Remove added models."""
    from depthcli.jobs.models import added_model, remove_model

    for name in models:
        added_model(name)  # raises before any is removed
    for name in dict.fromkeys(models):
        console.report(f"removed {one_line(str(remove_model(name)))}")
    return ExitCode.OK


@app.command("cards")
def list_cards(as_json: JsonOption = False) -> int:
    """List ready cards for well-known models to download."""
    from depthcli.models.catalog import ready_card, ready_names

    found = {name: ready_card(name) for name in ready_names()}
    if as_json:
        for name, card in found.items():
            console.out_json(_card_json(name, card))
        return ExitCode.OK
    console.print_table(
        ("card", "output", "license", "run with real weights", "summary"),
        [(n, output_text(c), c.license, _run_text(c), c.summary) for n, c in found.items()],
    )
    console.note(
        "a card that was never run with real weights may preprocess pictures incorrectly; check it "
        "against known depth: depthcli eval nyu --data NYU --split val --limit 20 --model NAME, "
        "with --align disparity for inverse depth"
    )
    return ExitCode.OK


def output_text(card: ModelCard) -> str:
    """Kind and unit of the output as text."""
    if card.output.max_m is not None and card.output.kind == "metric":
        return f"metric depth up to {card.output.max_m:g} m"
    return f"{card.output.kind} depth, no unit"


def _run_text(card: ModelCard) -> str:
    from depthcli.models.card import preprocessing_check

    check = preprocessing_check(card)
    return "yes" if check and check.run_with_weights else "no"


def _preprocessing_json(card: ModelCard) -> dict[str, object]:
    """Facts about the check of a card's preprocessing, for JSON; empty if there are none."""
    from depthcli.models.card import check_command, preprocessing_check

    check = preprocessing_check(card)
    if check is None:
        return {}
    stated = {"run_with_weights": check.run_with_weights, "verified": check.verified}
    return {"preprocessing": stated | {"check": check_command(card)}}


def _warn_of_preprocessing(card: ModelCard) -> None:
    from depthcli.models.card import check_command, preprocessing_check

    check = preprocessing_check(card)
    if check is not None and not check.run_with_weights:
        console.warn(
            "this card was never run with the real weights, so its preprocessing may be wrong. "
            f"{check.verified} Check it on a few pictures: {check_command(card)}"
        )


def _card_json(name: str, card: ModelCard) -> dict[str, object]:
    return {
        "name": name,
        "kind": card.output.kind.value,
        "license": card.license,
        "summary": card.summary,
        **card.training,
    }


@app.callback()
def _models_group(context: typer.Context) -> None:
    """The models that are bundled or installed; without a command, their list."""
    if context.invoked_subcommand is None:
        list_models()


@app.command("list")
def list_models(as_json: JsonOption = False) -> int:
    """List the models available by name.

    Search order: folders in DEPTHCLI_MODELS, models added with 'depthcli models add', bundled
    models.
    """
    from depthcli.models.catalog import list_locations

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
    from depthcli.models.catalog import find_model, list_locations, ready_fields, ready_names

    if model in ready_names() and model not in dict(list_locations()):
        console.out(json.dumps(ready_fields(model), indent=2, ensure_ascii=False))
    else:
        console.out(find_model(model).card.to_json().rstrip())
    return ExitCode.OK


@app.command()
def verify(
    models: list[str] | None = typer.Argument(
        None,
        autocompletion=completion.models,
        help="Model names or paths. Default: all listed models.",
    ),
    as_json: JsonOption = False,
) -> int:
    """Verify size, checksum and card, and run each model once."""
    from depthcli.jobs.models import verify_models

    failed = False
    for check in verify_models(models or ()):
        failed = failed or isinstance(check.found, DepthcliError)
        _print_check(check, as_json=as_json)
    return ExitCode.FAILURE if failed else ExitCode.OK


def _print_check(check: ModelCheck, *, as_json: bool) -> None:
    name, found = check.name, check.found
    if isinstance(found, DepthcliError):
        if as_json:
            reason = console.worded(found.message)
            console.out_json({"name": name, "status": "failed", "error": reason})
        else:
            console.error(found.message)
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
    facts: dict[str, object] = {"name": name, "path": str(place.path)}
    if isinstance(card, DepthcliError):
        return facts | {"status": "failed", "error": console.worded(card.message)}
    return facts | {
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
        return (name, "", "damaged", "", console.worded(card.message), str(place.path))
    size = "" if card.size_bytes is None else f"{card.size_bytes / 1e6:.1f} MB"
    return (name, card.version, card.output.kind, size, card.summary, str(place.path))
