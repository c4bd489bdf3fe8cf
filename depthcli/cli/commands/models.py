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
    from depthcli.models.card import ModelCard

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
    from depthcli.models.card import check_command, preprocessing_check
    from depthcli.models.catalog import location_at

    beside = None if card or is_remote(file) else location_at(path_of(file))
    with show_progress(silent=as_json or quiet) as progress:
        model = add_model(
            path_of(file), card, name=name, force=force, sha256=sha256, progress=progress
        )
    name, folder, check = model.card.name, model.path.parent, preprocessing_check(model.card)
    if as_json:
        added: dict[str, object] = {"name": name, "path": str(folder), "sha256": model.sha256}
        if check is not None:
            stated = {"run_with_weights": check.run_with_weights, "verified": check.verified}
            added["preprocessing"] = stated | {"check": check_command(model.card)}
        console.out_json(added)
        return ExitCode.OK
    if quiet:
        return ExitCode.OK
    console.report(one_line(f"{name}: {output_text(model.card)}, in {folder}"))
    if beside and beside.card:
        console.note(one_line(f"with the card {beside.card}"))
    if is_remote(file) and sha256 is None:
        console.note(f"to get exactly this file again: --sha256 {model.sha256}")
    if check is not None and not check.run_with_weights:
        console.warn(
            "this card was never run with the real weights, so its preprocessing may be wrong. "
            f"{check.verified} Check it on a few images: {check_command(model.card)}"
        )
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
    from depthcli.models.card import preprocessing_check
    from depthcli.models.catalog import ready_card, ready_names

    rows = []
    for name, card in ((name, ready_card(name)) for name in ready_names()):
        check = preprocessing_check(card)
        was_run = "yes" if check and check.run_with_weights else "no"
        rows.append((name, output_text(card), card.license, was_run, card.summary))
        if as_json:
            facts = {"license": card.license, "summary": card.summary, **card.training}
            console.out_json({"name": name, "kind": card.output.kind.value, **facts})
    if as_json:
        return ExitCode.OK
    console.print_table(("card", "output", "license", "run with real weights", "summary"), rows)
    console.note(
        "a card that was never run with real weights may preprocess images incorrectly; check it "
        "against known depth: depthcli eval nyu --data NYU --split val --limit 20 --model NAME, "
        "with --align disparity for inverse depth"
    )
    return ExitCode.OK


def output_text(card: ModelCard) -> str:
    """Kind and unit of the output as text."""
    if card.output.max_m is not None and card.output.kind == "metric":
        return f"metric depth up to {card.output.max_m:g} m"
    return f"{card.output.kind} depth, no unit"


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
    from depthcli.models.catalog import list_locations, read_model

    code, rows = ExitCode.OK, []
    for name, place in list_locations():
        shown: dict[str, object] = {"name": name, "path": str(place.path)}
        try:
            card = read_model(place).card
        except DepthcliError as error:
            code, reason = ExitCode.FAILURE, console.worded(error.message)
            rows.append((name, "", "damaged", "", reason, str(place.path)))
            shown |= {"status": "failed", "error": reason}
        else:
            kind, size = card.output.kind.value, card.size_bytes
            megabytes = "" if size is None else f"{size / 1e6:.1f} MB"
            rows.append((name, card.version, kind, megabytes, card.summary, str(place.path)))
            shown |= {"status": "ok", "version": card.version, "kind": kind, "bytes": size}
            shown |= {"sha256": card.sha256, "summary": card.summary, "license": card.license}
        if as_json:
            console.out_json(shown)
    if not as_json:
        console.print_table(("name", "version", "kind", "size", "summary", "path"), rows)
    return code


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

    code = ExitCode.OK
    for name, found in verify_models(models or ()):
        facts: dict[str, object]
        if isinstance(found, DepthcliError):
            code = ExitCode.FAILURE
            facts = {"status": "failed", "error": console.worded(found.message)}
        else:
            facts = {"status": "ok", "path": str(found.path), "sha256": found.sha256}
            facts["bytes"] = len(found.data)
        if as_json:
            console.out_json({"name": name, **facts})
        elif isinstance(found, DepthcliError):
            console.error(found.message)
        else:
            console.out(f"{one_line(name)}: ok, sha256 {found.sha256}")
    return code
