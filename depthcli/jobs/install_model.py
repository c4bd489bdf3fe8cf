"""Adding models to the user's folder, and removing them."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.validation import FieldError, parsed_json, validated
from depthcli.errors import InputError, ModelError, OutputError, UsageError
from depthcli.inference.session import Session
from depthcli.inference.trial import try_session
from depthcli.io.storage.atomic_folder import replace_folder, workspace
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.io.storage.transfer import local_copy
from depthcli.io.storage.user_folders import check_home
from depthcli.models import catalog, locations, onnx_file
from depthcli.models.card import METADATA_KEY, ModelCard
from depthcli.models.catalog import Model
from depthcli.models.graph_fit import fit_to_graph
from depthcli.models.locations import ModelLocation
from depthcli.models.ready_cards import ready_fields

_FILE_NAME = "model.onnx"
_SHA256 = re.compile(r"[0-9a-fA-F]{64}")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


class CardDraft(NamedTuple):
    """A card's JSON object before the facts of the model file are added."""

    fields: dict[str, Any]  #: the object
    where: str  #: name of its source in messages
    is_ready: bool  #: whether it is a ready card, whose input size may differ from the model's


def add_model(
    path: Path,
    card: str | None = None,
    *,
    name: str | None = None,
    force: bool = False,
    sha256: str | None = None,
    progress: Progress = NO_PROGRESS,
) -> Model:
    """Copy a model into the user's folder with its completed card, after running it once.

    Args:
        path: an ONNX file; a remote one is downloaded.
        card: a ``card.json`` or the name of a ready card; None if the card is inside the ONNX
            file, or beside it on this machine.
        name: name for ``--model``; None for the card's own name.
        force: replace a model of this name, or override a bundled one.
        sha256: checksum that the file must have, 64 hex digits; None for any.
        progress: advanced by downloaded bytes.

    Returns:
        The model in the user's folder.

    Raises:
        UsageError: the name is invalid or taken, or there is no such card.
        ModelError: the file is not a model that matches the card, or fails to run.
        OutputError: the folder cannot be written.
    """
    if sha256 is not None and not _SHA256.fullmatch(sha256):
        raise UsageError(f"{sha256!r} is not a SHA-256 checksum (64 hex digits)")
    if name is not None:
        _install_target(_valid_name(name), force=force)  # before anything is downloaded
    try:
        with local_copy(path, progress, max_bytes=catalog.MAX_BYTES) as file:
            return _install(file, card, name=name, force=force, sha256=sha256)
    except InputError as error:
        raise ModelError(str(error)) from error


def _install(
    path: Path, card: str | None, *, name: str | None, force: bool, sha256: str | None
) -> Model:
    data = catalog.read_onnx(path)
    found = hashlib.sha256(data).hexdigest()
    if sha256 is not None and found != sha256.lower():
        raise ModelError(f"{path} is another file: its sha256 is {found}; it is not added")
    draft = _card_draft(path, data, card)
    complete = _complete_card(draft, path, data, found, name)
    target = _install_target(complete.name, force=force)
    if target.is_dir():  # the old one is kept until the new card is in place
        complete = replace(complete, file=f"model-{found[:12]}.onnx")
    with workspace(target.parent) as work:
        temporary = work / target.name
        temporary.mkdir()
        (temporary / (complete.file or _FILE_NAME)).write_bytes(data)
        (temporary / locations.CARD_NAME).write_text(complete.to_json(), "utf-8")
        model = replace(catalog.find_model(temporary), path=path)  # the name in messages
        session = Session(model, provider="cpu")
        fitted = fit_to_graph(complete, session.fixed_size, path, adapt=draft.is_ready)
        session.model = replace(model, card=fitted)
        try_session(session)
        (temporary / locations.CARD_NAME).write_text(fitted.to_json(), "utf-8")
        replace_folder(temporary, target, last=locations.CARD_NAME)
    return catalog.find_model(target)


def added_model(name: str) -> tuple[Path, locations.ModelLocation]:
    """Folder and files of a model that was added.

    Raises:
        UsageError: it is not in the user's folder.
    """
    folder = locations.user_root() / _valid_name(name)
    location = _user_location(folder)
    if location is None:
        raise UsageError(
            f"{name!r} is not among the models in {locations.user_root()}; only those are removed"
        )
    return folder, location


def remove_model(name: str) -> Path:
    """Delete a model that was added.

    Args:
        name: as in the list of models.

    Returns:
        The path that was removed.

    Raises:
        UsageError: it is not in the user's folder.
        OutputError: it cannot be deleted.
    """
    folder, location = added_model(name)
    try:
        if folder.is_symlink():
            folder.unlink()
        elif folder.is_dir():
            with workspace(folder.parent) as work:
                folder.rename(work / folder.name)
        else:
            for file in (location.onnx, location.card):
                if file is not None:
                    file.unlink()
    except OSError as error:
        raise OutputError(f"cannot remove {folder}: {error.strerror}") from error
    return folder


def _card_draft(path: Path, data: bytes, card: str | None) -> CardDraft:
    if card is None:
        location = locations.location_at(path)
        card = str(location.card) if location and location.card else None
    if card is None:
        embedded = onnx_file.metadata(data, str(path)).get(METADATA_KEY)
        if embedded is None:
            raise UsageError(
                f"{path} has no card inside or beside it; give --card, "
                "and see 'depthcli models cards' for ready ones"
            )
        return CardDraft(
            _json_object(embedded, f"card inside {path}"), f"card inside {path}", False
        )
    if card.endswith(".json") or path_of(card).is_file():
        return CardDraft(
            _json_object(catalog.read_card(path_of(card)), safe_name(card)), card, False
        )
    return CardDraft(ready_fields(card), f"card {card}", True)


def _json_object(text: str | bytes, where: str) -> dict[str, Any]:
    try:
        return validated(dict[str, Any], parsed_json(text))
    except FieldError as refused:
        raise ModelError(f"{where}: {refused}; correct it") from None


def _complete_card(
    draft: CardDraft, path: Path, data: bytes, sha256: str, name: str | None
) -> ModelCard:
    """The card, completed with name, size, checksum and versions of the file."""
    opset, ir = onnx_file.versions(data, str(path))
    stated = draft.fields.get("onnx")
    output = {"output": stated["output"]} if isinstance(stated, dict) and "output" in stated else {}
    fields = draft.fields | {"onnx": {"opset": opset, "ir": ir, **output}, "file": _FILE_NAME}
    if name is not None:
        fields["name"] = name
    card = ModelCard.from_json(json.dumps(fields), where=draft.where)
    _valid_name(card.name)
    catalog.check_file(card, path, len(data), sha256)
    return replace(card, sha256=sha256, size_bytes=len(data))


def _user_location(folder: Path) -> ModelLocation | None:
    """A model in the user's folder, as a folder or as a single file."""
    return locations.location_at(folder) or locations.location_at(
        folder.with_name(f"{folder.name}.onnx")
    )


def _valid_name(name: str) -> str:
    if not _NAME.fullmatch(name) or name.endswith(".onnx"):
        raise UsageError(
            f"{name!r} is not a valid model name; give --name with letters, digits, '.', '_' and "
            "'-', beginning with a letter or digit"
        )
    return name


def _install_target(name: str, *, force: bool) -> Path:
    target = locations.user_root() / name
    check_home(target)
    taken = next((p for n, p in locations.list_locations() if n == name), None)
    if taken is not None and not force:
        raise UsageError(
            f"a model named {name!r} already exists ({taken.path}); give another --name, or --force"
        )
    if target.is_symlink():
        raise UsageError(f"{target} is a link; remove it first: depthcli models remove {name}")
    return target
