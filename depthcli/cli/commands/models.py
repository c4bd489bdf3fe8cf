"""``depthcli models`` and ``doctor``: the models, and whether the installation runs them."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from typing import TYPE_CHECKING, Literal

import typer

from depthcli.cli import options, parse
from depthcli.cli.screen import console
from depthcli.core.camera import hfov_deg
from depthcli.core.options import one_line
from depthcli.errors import DepthcliError, ExitCode
from depthcli.io.storage.paths import RemotePath, path_of

if TYPE_CHECKING:
    from depthcli.models.card import ModelCard, WeightsSpec


def add_model_file(
    file: str = typer.Argument(
        ...,
        metavar="FILE",
        autocompletion=options.cards,
        help="ONNX file with embedded weights, or its URL; or a ready card or card.json that says "
        "where to download it.",
    ),
    card: str | None = typer.Option(
        None,
        "--card",
        metavar="CARD",
        autocompletion=options.cards,
        help="A card.json, or the name of a ready card ('depthcli models cards'). Default: the "
        "card in the file, or next to it on this machine.",
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
    *,
    screen: options.ScreenOptions,
) -> int:
    """Add an ONNX model after checking its card.

    Copies the file to the first folder in DEPTHCLI_MODELS, else to depthcli/models in the user's
    data folder, after running the model once.
    """
    from depthcli.jobs.models import add_model, published_model
    from depthcli.models.card import check_command, preprocessing_check, verification_text

    published = published_model(file) if card is None else None
    if published and screen.shows_text:
        size = size_text(published.weights) or "of unknown size"
        console.note(one_line(f"{published.url}, {size}, licence {published.card.license}"))
    with screen.show_progress() as progress:
        source = published or path_of(file)
        model = add_model(source, card, name=name, force=force, sha256=sha256, progress=progress)
    name, folder, check = model.card.name, model.path.parent, preprocessing_check(model.card)
    if screen.as_json:
        added: dict[str, object] = {"name": name, "path": str(folder), "sha256": model.sha256}
        added |= {"license": model.card.license}
        added |= {"url": str(published.url)} if published else {}
        if check is not None:
            extra_fields = {"run_with_weights": check.run_with_weights, "verified": check.verified}
            added["preprocessing"] = extra_fields | {"check": check_command(model.card)}
        console.out_json(added)
        return ExitCode.OK
    if screen.quiet:
        return ExitCode.OK
    console.out(one_line(f"{name}: {output_text(model.card)}, in {folder}"))
    verified = "not verified" if check is None else f"verified: {check.verified}"
    facts = f"{metres_text(model.card)}; licence {model.card.license}; {verified}"
    console.note(one_line(facts))
    is_remote = isinstance(path_of(file), RemotePath)
    if sha256 is None and (is_remote or (published and published.weights.sha256 is None)):
        console.note(f"to get exactly this file again: --sha256 {model.sha256}")
    if model.card.verification and model.card.verification.difference is not None:
        console.note(f"compared with the authors' code: {verification_text(model.card)}")
    elif check is not None and not check.run_with_weights:
        console.warn(
            "this card was never run with the real weights, so its preprocessing may be wrong. "
            f"Check it on a few images: {check_command(model.card)}"
        )
    return ExitCode.OK


def write_new_card(
    file: str = typer.Argument(..., metavar="FILE", help="ONNX file of a depth network."),
    out: str | None = typer.Option(
        None, "-o", "--out", metavar="CARD", help="The card. Default: FILE.card.json beside FILE."
    ),
    kind: Literal["metric", "relative", "inverse"] | None = typer.Option(
        None, help="What the output is: metric (metres), relative (larger is farther), inverse."
    ),
    colour: Literal["value", "luma", "rgb"] | None = typer.Option(
        None, help="Channels of the input; value is the largest of R, G and B."
    ),
    mean: str | None = typer.Option(
        None, metavar="R,G,B", help="Mean that is subtracted from colours in [0, 1]."
    ),
    std: str | None = typer.Option(None, metavar="R,G,B", help="Divisor of colours after that."),
    depth_output: str | None = typer.Option(
        None, metavar="NAME", help="Output that is the depth map, where there are several."
    ),
    overwrite: options.OverwriteOption = False,
) -> int:
    """Write a card for an ONNX file of your own, to correct and to add it with.

    Size, channels, layout, outputs and opset are those of the file. What it does not state is
    guessed, and each guess is printed.
    """
    from depthcli.core.types import DepthKind
    from depthcli.jobs.models import Answers, new_card
    from depthcli.models.card import Colour

    def numbers(word: str | None, name: str) -> tuple[float, ...] | None:
        form = "R,G,B" if word and "," in word else "X"
        return tuple(parse.numbers(word, form, "0.485,0.456,0.406", option=name)) if word else None

    kind_, colour_ = kind and DepthKind(kind), colour and Colour(colour)
    answers = Answers(kind_, colour_, numbers(mean, "mean"), numbers(std, "std"), depth_output)
    target = None if out is None else path_of(out)
    path, guesses = new_card(path_of(file), target, answers, overwrite=overwrite)
    for guess in guesses:
        console.warn(f"guessed: {guess}")
    console.out(one_line(str(path)))
    command = shlex.join(["depthcli", "models", "add", file, "--card", str(path)])
    console.note(one_line(f"check the guesses, then run: {command}"))
    return ExitCode.OK


def remove_models(
    models: list[str] = typer.Argument(
        ..., metavar="NAME...", autocompletion=options.models, help="Names of added models."
    ),
) -> int:
    """Remove added models."""
    from depthcli.jobs.models import added_model, remove_model

    for name in models:
        added_model(name)  # raises before any is removed
    for name in dict.fromkeys(models):
        console.out(f"removed {one_line(str(remove_model(name)))}")
    return ExitCode.OK


def list_cards(
    names: list[str] | None = typer.Argument(
        None,
        metavar="[CARD...]",
        autocompletion=options.cards,
        help="Show everything about these cards. Default: the list of all.",
    ),
    as_json: options.JsonOption = False,
) -> int:
    """List ready cards for well-known models, and where their weights are."""
    from depthcli.models.card import preprocessing_check, verification_text
    from depthcli.models.catalog import ready_card, ready_names

    rows = []
    for name, card in [(name, ready_card(name)) for name in names or ready_names()]:
        check = preprocessing_check(card)
        was_run = "yes" if check and check.run_with_weights else "no"
        page = card.weights.page if card.weights else ""
        facts = (output_text(card), card.license, was_run, verification_text(card))
        rows.append((name, *facts, page, card.summary))
        if as_json:
            details = {"license": card.license, "summary": card.summary}
            weights = json.loads(card.to_json()).get("weights", {})
            record = {"name": name, "kind": card.output.kind.value, **details, "weights": weights}
            console.out_json(record | dict(card.training))
        elif names:
            console.out(card_text(card))
    if as_json or names:
        return ExitCode.OK
    headings = ("output", "license", "run with real weights", "verified", "weights", "summary")
    console.print_table(("card", *headings), rows)
    console.note("what a card says about its weights: depthcli models cards CARD")
    return ExitCode.OK


def card_text(card: ModelCard) -> str:
    """Everything about a ready card that somebody needs who adds its weights."""
    from depthcli.models.card import preprocessing_check, verification_text

    weights, check = card.weights, preprocessing_check(card)
    lines = [card.name, card.summary, f"{output_text(card)}; {metres_text(card)}"]
    lines.append(f"licence of the weights: {card.license}")
    if weights:
        lines.append(f"weights: {weights.page}")
    if weights and weights.url:
        sum_ = f", sha256 {weights.sha256}" if weights.sha256 else ""
        lines.append(f"ONNX file: {weights.url}{size_text(weights, ', ')}{sum_}")
        lines.append(f"to add it: depthcli models add {card.name}")
    if weights and weights.export:
        lines.append(f"to export it: {weights.export}")
    if check:
        lines.append(f"verified: {check.verified}")
    lines.append(f"compared with the authors' code: {verification_text(card)}")
    return "\n  ".join(one_line(line) for line in lines)


def size_text(weights: WeightsSpec, before: str = "") -> str:
    """Size of a published file; empty if it is not known."""
    size = weights.size_bytes
    return "" if size is None else f"{before}{size / 1e6:.1f} MB"


def metres_text(card: ModelCard) -> str:
    """The facts that a model needs for metres, as text."""
    if card.output.kind != "metric":
        return "metres need known points (--anchor, --anchors)"
    follow = "metres follow the focal length (--focal-px, --hfov, EXIF), without one"
    if card.output.points or (card.camera and card.camera.hfov_output):
        return f"{follow} that which the model estimates"
    if card.camera is None:
        return "metres need no focal length"
    width = card.input.width
    return f"{follow} that of {hfov_deg(card.camera.focal_px_at(width), width):.3g}°"


def output_text(card: ModelCard) -> str:
    """Kind and unit of the output as text."""
    if card.output.max_m is not None and card.output.kind == "metric":
        return f"metric depth up to {card.output.max_m:g} m"
    return f"{card.output.kind} depth, no unit"


def list_models(as_json: options.JsonOption = False) -> int:
    """List the models available by name.

    Search order: folders in DEPTHCLI_MODELS, models added with 'depthcli models add', bundled
    models.
    """
    from depthcli.models.catalog import list_locations, read_model

    code, rows = ExitCode.OK, []
    for name, place in list_locations():
        path, facts = str(place.path), dict[str, object]()
        try:
            card = read_model(place).card
        except DepthcliError as error:
            code, reason = ExitCode.FAILURE, console.worded(error.message)
            rows.append((name, "", "damaged", "", reason, path))
            facts = {"status": "failed", "error": reason}
        else:
            kind, size = card.output.kind.value, card.size_bytes
            megabytes = "" if size is None else f"{size / 1e6:.1f} MB"
            rows.append((name, card.version, kind, megabytes, card.summary, path))
            facts = {"status": "ok", "version": card.version, "kind": kind, "bytes": size}
            facts |= {"sha256": card.sha256, "summary": card.summary, "license": card.license}
        if as_json:
            console.out_json({"name": name, "path": path, **facts})
    if not as_json:
        console.print_table(("name", "version", "kind", "size", "summary", "path"), rows)
    return code


def show_model(
    model: str = typer.Argument(
        "default",
        metavar="[MODEL]",
        autocompletion=lambda: [*options.models(), *options.cards()],
        help="Model name, .onnx file, folder with a card.json, or name of a ready card.",
    ),
) -> int:
    """Show a model's card, or a ready card, as JSON."""
    from depthcli.models.catalog import find_model, list_locations, ready_fields, ready_names

    if model in ready_names() and model not in dict(list_locations()):
        console.out(json.dumps(ready_fields(model), indent=2, ensure_ascii=False))
    else:
        console.out(find_model(model).card.to_json().rstrip())
    return ExitCode.OK


def verify(
    models: list[str] | None = typer.Argument(
        None,
        metavar="[MODEL...]",
        autocompletion=options.models,
        help="Model names or paths. Default: all listed models.",
    ),
    as_json: options.JsonOption = False,
) -> int:
    """Verify size, checksum and card, and run each model once."""
    from depthcli.jobs.models import verify_models

    code = ExitCode.OK
    for name, outcome in verify_models(models or ()):
        if not isinstance(outcome, DepthcliError):
            facts: dict[str, object] = {"name": name, "status": "ok", "path": str(outcome.path)}
            facts |= {"sha256": outcome.sha256, "bytes": outcome.size_bytes}
            console.show(facts, f"{name}: ok, sha256 {outcome.sha256}", as_json=as_json)
            continue
        code, reason = ExitCode.FAILURE, outcome.message
        if as_json:
            console.out_json({"name": name, "status": "failed", "error": console.worded(reason)})
        else:
            console.error(reason)
    return code


def doctor(
    model: str | None = typer.Option(
        None,
        "--model",
        metavar="MODEL",
        autocompletion=options.models,
        help="Model to check, by name or path.",
    ),
    provider: str = typer.Option(
        "auto",
        metavar="NAME",
        autocompletion=lambda: options.PROVIDERS,
        help="Execution provider to check.",
    ),
    as_json: options.JsonOption = False,
) -> int:
    """Check versions, onnxruntime packages, the provider really active, a model, and codecs.

    Exit code 0 if everything needed works, 3 if something does not.
    """
    from depthcli.jobs.doctor import check_installation

    failed = False
    for check in check_installation(model, provider):
        failed = failed or check.status == "failed"
        text = f"{check.status:<8} {check.name:<24} {check.detail}"
        console.show(asdict(check), text, as_json=as_json)
    return ExitCode.FAILURE if failed else ExitCode.OK


COMMANDS = {
    "": list_models,
    "add": add_model_file,
    "remove": remove_models,
    "cards": list_cards,
    "list": list_models,
    "new-card": write_new_card,
    "show": show_model,
    "verify": verify,
}
