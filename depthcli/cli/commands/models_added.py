"""``depthcli models add``, ``remove`` and ``cards``: adding third-party models."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.arguments import completion
from depthcli.cli.arguments.options import JsonOutputOption, QuietOption
from depthcli.cli.screen import console
from depthcli.core.text import one_line
from depthcli.errors import ExitCode

if TYPE_CHECKING:
    from depthcli.models.card import ModelCard


def add_model_file(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="ONNX file with embedded weights, or its URL.")
    ],
    card: Annotated[
        str | None,
        typer.Option(
            "--card",
            metavar="CARD",
            autocompletion=completion.cards,
            help="A card.json, or the name of a ready card ('depthcli models cards'). Default: "
            "the card in the file, or next to one on this machine.",
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            "--name", metavar="NAME", help="Name for --model. Default: the name in the card."
        ),
    ] = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Replace an existing model of this name, or override a bundled one."
        ),
    ] = False,
    sha256: Annotated[
        str | None, typer.Option(metavar="HEX", help="SHA-256 checksum that the file must have.")
    ] = None,
    as_json: JsonOutputOption = False,
    quiet: QuietOption = False,
) -> int:
    """Add an ONNX model after checking its card.

    Copies the file to the first folder in DEPTHCLI_MODELS, else to depthcli/models in the user's
    data folder, after running the model once.
    """
    from depthcli.cli.screen.progress import show_progress
    from depthcli.io.storage.remote import is_remote, path_of
    from depthcli.jobs.install_model import add_model

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


def remove_models(
    models: Annotated[
        list[str],
        typer.Argument(
            metavar="NAME...", autocompletion=completion.added_models, help="Names of added models."
        ),
    ],
) -> int:
    """Remove added models."""
    from depthcli.jobs.added_models import added_model, remove_model

    for name in models:
        added_model(name)  # raises before any is removed
    for name in dict.fromkeys(models):
        console.report(f"removed {one_line(str(remove_model(name)))}")
    return ExitCode.OK


def list_cards(as_json: JsonOutputOption = False) -> int:
    """List ready cards for well-known models to download."""
    from depthcli.models.ready_cards import ready_card, ready_names

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
    from depthcli.models.preprocessing_check import preprocessing_check

    check = preprocessing_check(card)
    return "yes" if check and check.run_with_weights else "no"


def _preprocessing_json(card: ModelCard) -> dict[str, object]:
    """Facts about the check of a card's preprocessing, for JSON; empty if there are none."""
    from depthcli.models.preprocessing_check import check_command, preprocessing_check

    check = preprocessing_check(card)
    if check is None:
        return {}
    stated = {"run_with_weights": check.run_with_weights, "verified": check.verified}
    return {"preprocessing": stated | {"check": check_command(card)}}


def _warn_of_preprocessing(card: ModelCard) -> None:
    from depthcli.models.preprocessing_check import check_command, preprocessing_check

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
