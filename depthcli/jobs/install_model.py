"""Taking a model of your own into the user's folder, and out of it again."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from depthcli.core.foreign import FieldError, built, parsed_json
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.errors import InputError, ModelError, OutputError, UsageError
from depthcli.inference.session import Session
from depthcli.inference.trial import try_session
from depthcli.io.storage.atomic_folder import put_folder, workspace
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.io.storage.transfer import local_copy
from depthcli.io.storage.user_folders import check_home
from depthcli.models import catalog, onnx_file, places
from depthcli.models.card import METADATA_KEY, ModelCard
from depthcli.models.catalog import Model
from depthcli.models.graph_fit import fit_to_graph
from depthcli.models.places import Place
from depthcli.models.ready_cards import ready_fields

_FILE_NAME = "model.onnx"
_SHA256 = re.compile(r"[0-9a-fA-F]{64}")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


class CardDraft(NamedTuple):
    """A card's JSON object before it belongs to a file."""

    fields: dict[str, Any]  #: the object
    where: str  #: what messages call it
    is_ready: bool  #: whether it is one of the ready cards, whose size is only the usual one


def add_model(
    path: Path,
    card: str | None = None,
    *,
    name: str | None = None,
    force: bool = False,
    sha256: str | None = None,
    progress: Progress = NO_PROGRESS,
) -> Model:
    """Copy a model into the user's folder, with a card that is complete and was tried.

    Args:
        path: an ONNX file; a remote one is fetched, and nothing else.
        card: a ``card.json`` or the name of a ready card; None if the card is inside the ONNX
            file, or beside it on this machine.
        name: what ``--model`` shall call it; None for the card's own name.
        force: replace a model of this name, or hide a bundled one.
        sha256: that the file must have, 64 hex digits; None for any.
        progress: told of each byte that is fetched.

    Returns:
        The model as it lies in the user's folder.

    Raises:
        UsageError: the name is no name or is taken, or there is no such card.
        ModelError: the file is no such model, or it does not do what its card says.
        OutputError: the folder cannot be written.
    """
    if sha256 is not None and not _SHA256.fullmatch(sha256):
        raise UsageError(f"{sha256!r} is not a SHA-256 checksum (64 hex digits)")
    if name is not None:
        _install_target(_checked_name(name), force=force)  # before anything is fetched
    try:
        with local_copy(path, progress, max_bytes=catalog.MAX_BYTES) as file:
            return _added(file, card, name=name, force=force, sha256=sha256)
    except InputError as error:
        raise ModelError(str(error)) from error


def _added(
    path: Path, card: str | None, *, name: str | None, force: bool, sha256: str | None
) -> Model:
    data = catalog.read_onnx(path)
    found = hashlib.sha256(data).hexdigest()
    if sha256 is not None and found != sha256.lower():
        raise ModelError(f"{path} is another file: its sha256 is {found}; it is not added")
    draft = _draft(path, data, card)
    complete = _complete(draft, path, data, found, name)
    target = _install_target(complete.name, force=force)
    if target.is_dir():  # the old one stays until the new card is there
        complete = replace(complete, file=f"model-{found[:12]}.onnx")
    with workspace(target.parent) as work:
        temporary = work / target.name
        temporary.mkdir()
        (temporary / (complete.file or _FILE_NAME)).write_bytes(data)
        (temporary / places.CARD_NAME).write_text(complete.to_json(), "utf-8")
        model = replace(catalog.find_model(temporary), path=path)  # what messages name
        session = Session(model, provider="cpu")
        fitted = fit_to_graph(complete, session.fixed_size, path, adapt=draft.is_ready)
        session.model = replace(model, card=fitted)
        try_session(session)
        (temporary / places.CARD_NAME).write_text(fitted.to_json(), "utf-8")
        put_folder(temporary, target, last=places.CARD_NAME)
    return catalog.find_model(target)


def remove_model(name: str) -> Path:
    """Delete a model that was added.

    Args:
        name: as in the list of models.

    Returns:
        Where it was.

    Raises:
        UsageError: it is not in the user's folder.
        OutputError: it cannot be deleted.
    """
    folder = places.user_root() / _checked_name(name)
    place = _user_place(folder)
    if place is None:
        raise UsageError(
            f"{name!r} is not among the models in {places.user_root()}; only those are removed"
        )
    try:
        if folder.is_symlink():
            folder.unlink()
        elif folder.is_dir():
            with workspace(folder.parent) as work:
                folder.rename(work / folder.name)
        else:
            for file in (place.onnx, place.card):
                if file is not None:
                    file.unlink()
    except OSError as error:
        raise OutputError(f"cannot remove {folder}: {error.strerror}") from error
    return folder


def _draft(path: Path, data: bytes, card: str | None) -> CardDraft:
    if card is None:
        place = places.place_at(path)
        card = str(place.card) if place and place.card else None
    if card is None:
        embedded = onnx_file.metadata(data, str(path)).get(METADATA_KEY)
        if embedded is None:
            raise UsageError(
                f"{path} has no card inside or beside it; give --card, "
                "and see 'depthcli models cards' for ready ones"
            )
        return CardDraft(_object(embedded, f"card inside {path}"), f"card inside {path}", False)
    if card.endswith(".json") or path_of(card).is_file():
        return CardDraft(_object(catalog.read_card(path_of(card)), safe_name(card)), card, False)
    return CardDraft(ready_fields(card), f"card {card}", True)


def _object(text: str | bytes, where: str) -> dict[str, Any]:
    try:
        return built(dict[str, Any], parsed_json(text))
    except FieldError as refused:
        raise ModelError(f"{where}: {refused}; correct it") from None


def _complete(
    draft: CardDraft, path: Path, data: bytes, sha256: str, name: str | None
) -> ModelCard:
    """The card with all that the file itself says."""
    opset, ir = onnx_file.versions(data, str(path))
    fields = draft.fields | {"onnx": {"opset": opset, "ir": ir}, "file": _FILE_NAME}
    if name is not None:
        fields["name"] = name
    card = ModelCard.from_json(json.dumps(fields), where=draft.where)
    _checked_name(card.name)
    catalog.check_file(card, path, len(data), sha256)
    return replace(card, sha256=sha256, size_bytes=len(data))


def _user_place(folder: Path) -> Place | None:
    """A model of the user's folder, in a folder of its own or as one file."""
    return places.place_at(folder) or places.place_at(folder.with_name(f"{folder.name}.onnx"))


def _checked_name(name: str) -> str:
    if not _NAME.fullmatch(name) or name.endswith(".onnx"):
        raise UsageError(
            f"{name!r} is not a valid model name; give --name with letters, digits, '.', '_' and "
            "'-', beginning with a letter or digit"
        )
    return name


def _install_target(name: str, *, force: bool) -> Path:
    target = places.user_root() / name
    check_home(target)
    taken = next((p for n, p in places.list_places() if n == name), None)
    if taken is not None and not force:
        raise UsageError(
            f"a model named {name!r} already exists ({taken.path}); give another --name, or --force"
        )
    if target.is_symlink():
        raise UsageError(f"{target} is a link; remove it first: depthcli models remove {name}")
    return target
