"""Finding, reading and checking a model before it is run."""

import hashlib
import os
from dataclasses import dataclass, field
from errno import ENOENT
from pathlib import Path
from typing import Any

from depthcli.core.validation import FieldError, parsed_json, validated
from depthcli.errors import ModelError
from depthcli.io.storage.remote import RemotePath
from depthcli.models import onnx_file
from depthcli.models.card import METADATA_KEY, ModelCard
from depthcli.models.locations import CARD_NAME, CARD_SUFFIX, ModelLocation, find_location

MAX_BYTES = 2**31 - 1  # a protobuf message cannot be larger
_MAX_CARD_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class Model:
    """A model that was read and checked.

    Attributes:
        path: its ONNX file.
        card: describes its input and output.
        sha256: checksum of the file, 64 hex digits.
        data: the file's bytes, the same ones that were checked.
    """

    path: Path
    card: ModelCard
    sha256: str
    data: bytes = field(repr=False)


def find_model(name_or_path: str | os.PathLike[str] | None = None) -> Model:
    """Find, read and check a model.

    Args:
        name_or_path: a name in the catalog, a folder with a ``card.json``, or an ``.onnx`` file
            with its card inside or beside it, where a ``card.json`` has to name the file; None for
            the default model.

    Raises:
        ModelError: not found, no card, damaged, external data, or a checksum that differs.
    """
    return read_model(find_location(name_or_path))


def read_model(location: ModelLocation) -> Model:
    """Read and check a model.

    Raises:
        ModelError: no card, damaged, external data, or a checksum that differs.
    """
    card = None
    if location.card:
        card = ModelCard.from_json(read_card(location.card), where=str(location.card))
    path = _onnx_path(location, card)
    data = _read_limited(path, MAX_BYTES)
    sha256 = hashlib.sha256(data).hexdigest()
    if card:
        check_file(card, path, len(data), sha256)
    onnx_file.refuse_external_data(data, str(path))
    embedded = onnx_file.metadata(data, str(path)).get(METADATA_KEY)
    if card is None:
        beside = path.with_name(CARD_NAME)
        if embedded is None and beside.is_file():
            card = ModelCard.from_json(read_card(beside), where=str(beside))
            if card.file == path.name:
                check_file(card, path, len(data), sha256)
                return Model(path, card, sha256, data)
        if embedded is None:
            raise ModelError(
                f"{path} has no card; put {path.stem}{CARD_SUFFIX} beside it, "
                "or export it with 'depthcli export-onnx'"
            )
        card = ModelCard.from_json(embedded, where=f"card inside {path}")
    return Model(path=path, card=card, sha256=sha256, data=data)


def read_onnx(path: Path) -> bytes:
    """The bytes of a complete ONNX file whose weights are all inside.

    Raises:
        ModelError: it is not one.
    """
    data = _read_limited(path, MAX_BYTES)
    onnx_file.refuse_external_data(data, str(path))
    onnx_file.metadata(data, str(path))
    return data


def read_card(path: Path) -> bytes:
    """The text of a card's file.

    Raises:
        ModelError: it cannot be read, or is too large for a card.
    """
    return _read_limited(path, _MAX_CARD_BYTES)


def file_of_card(card: Path) -> str | None:
    """Name of the ONNX file that a card states; None if it cannot be read, or states none."""
    try:
        fields = validated(dict[str, Any], parsed_json(read_card(card)))
    except (ModelError, FieldError):
        return None
    file = fields.get("file")
    return file if isinstance(file, str) else None


def _onnx_path(location: ModelLocation, card: ModelCard | None) -> Path:
    if location.onnx:
        return location.onnx
    if card is None or card.file is None:
        raise ModelError(
            f"{location.path}: file is missing; name the model's ONNX file in the card"
        )
    return location.path.with_name(card.file)


def _read_limited(path: Path, max_bytes: int) -> bytes:
    try:
        if isinstance(path, RemotePath):
            return path.read_some(max_bytes)
        size = path.stat().st_size
        if not 0 < size <= max_bytes:
            state = "empty" if size == 0 else f"too large ({size} bytes)"
            raise ModelError(f"{path} is {state}; download or export the model again")
        return path.read_bytes()
    except OSError as error:
        what = "check its name and its folder" if error.errno == ENOENT else "restore the model"
        raise ModelError(f"cannot read {path}: {error.strerror}; {what}") from error


def check_file(card: ModelCard, path: Path, size: int, sha256: str) -> None:
    """Compare a file's size in bytes and SHA-256 in hex with those in its card, if it has them.

    Raises:
        ModelError: they differ.
    """
    again = "download or export the model again"
    if card.size_bytes is not None and card.size_bytes != size:
        raise ModelError(f"{path} has {size} bytes, its card says {card.size_bytes}; {again}")
    if card.sha256 is not None and card.sha256 != sha256:
        raise ModelError(f"{path} has another checksum than its card says; {again}")
