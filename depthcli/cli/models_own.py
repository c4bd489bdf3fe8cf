"""``depthcli models add``, ``remove`` and ``cards``: models that others made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli import console
from depthcli.errors import ExitCode

if TYPE_CHECKING:
    from depthcli.inference.card import ModelCard

_Json = Annotated[bool, typer.Option("--json", help="JSON instead of text.")]


def add(
    file: Annotated[str, typer.Argument(metavar="FILE", help="An ONNX file, weights inside.")],
    card: Annotated[
        str | None,
        typer.Option(
            metavar="CARD",
            help="A card.json, or the name of a ready card ('depthcli models cards'). Default: the "
            "card inside the file or beside it.",
        ),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="What --model shall call it. Default: the card's name.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace a model of this name, or hide a bundled one.")
    ] = False,
    as_json: _Json = False,
) -> int:
    """Copy an ONNX file into your models, with a card that was checked and tried.

    The folder is the first of DEPTHCLI_MODELS, else depthcli/models in your data folder.
    """
    from pathlib import Path

    from depthcli.inference.install import add_model

    model = add_model(Path(file), card, name=name, force=force)
    if as_json:
        console.out_json(
            {"name": model.card.name, "path": str(model.path.parent), "sha256": model.sha256}
        )
    else:
        said = console.one_line(f"{model.card.name}: {what_comes_out(model.card)}")
        console.out(f"{said}, in {console.one_line(str(model.path.parent))}")
    return ExitCode.OK


def remove(
    models: Annotated[list[str], typer.Argument(metavar="NAME...", help="Models that were added.")],
) -> int:
    """Delete models that were added. Bundled ones stay."""
    from depthcli.inference.install import remove_model

    for name in models:
        console.out(f"removed {console.one_line(str(remove_model(name)))}")
    return ExitCode.OK


def cards(as_json: _Json = False) -> int:
    """List the ready cards, for models that you download yourself."""
    from depthcli.inference.ready_cards import ready_card, ready_names

    found = {name: ready_card(name) for name in ready_names()}
    if as_json:
        for name, card in found.items():
            console.out_json(_listed(name, card))
        return ExitCode.OK
    console.table(
        ("card", "output", "license", "summary"),
        [(n, what_comes_out(card), card.license, card.summary) for n, card in found.items()],
    )
    return ExitCode.OK


def what_comes_out(card: ModelCard) -> str:
    """Kind of output in words; metres only where they are."""
    if card.output.max_m is not None and card.output.kind == "metric":
        return f"metric depth up to {card.output.max_m:g} m"
    return f"{card.output.kind} depth, no unit"


def _listed(name: str, card: ModelCard) -> dict[str, object]:
    return {
        "name": name,
        "kind": card.output.kind.value,
        "license": card.license,
        "summary": card.summary,
        **card.training,
    }
