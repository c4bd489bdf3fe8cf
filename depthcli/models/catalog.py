"""Finding a model by name or path, and checking it before anything runs it."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from errno import ENOENT
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.errors import ModelError
from depthcli.io.storage.user_folders import data_folder
from depthcli.models import onnx_file
from depthcli.models.card import METADATA_KEY, ModelCard

if TYPE_CHECKING:
    from collections.abc import Iterator

DEFAULT_MODEL = "default"
MODELS_VARIABLE = "DEPTHCLI_MODELS"
CARD_NAME = "card.json"
_CARD_SUFFIX = ".card.json"
_ONNX_SUFFIX = ".onnx"
_MAX_BYTES = 2**31 - 1  # a protobuf message cannot be larger
_MAX_CARD_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class Model:
    """A model that was read and checked.

    Attributes:
        path: its ONNX file.
        card: what it takes and gives.
        sha256: checksum of the file, 64 hex digits.
        data: the file's bytes, the same ones that were checked.
    """

    path: Path
    card: ModelCard
    sha256: str
    data: bytes = field(repr=False)


@dataclass(frozen=True, slots=True)
class Place:
    """Where a model lies; nothing has been read yet.

    Attributes:
        onnx: the ONNX file; None where only its card names it.
        card: the card's file; None if the card is inside the ONNX file.
    """

    onnx: Path | None
    card: Path | None

    @property
    def path(self) -> Path:
        """The file that stands for the model in messages."""
        path = self.card or self.onnx
        if path is None:
            raise ValueError("a place has a model or a card")
        return path


def find_model(name_or_path: str | os.PathLike[str] | None = None) -> Model:
    """Find, read and check a model.

    Args:
        name_or_path: a name in the catalog, a folder with a ``card.json``, or an ``.onnx`` file
            with its card inside or beside it; None for the default model.

    Raises:
        ModelError: not found, no card, damaged, external data, or a checksum that differs.
    """
    return read_model(locate(name_or_path))


def locate(name_or_path: str | os.PathLike[str] | None = None) -> Place:
    """Where a model lies, without reading it.

    Raises:
        ModelError: there is no such model.
    """
    name = os.fspath(name_or_path) if name_or_path is not None else DEFAULT_MODEL
    if not name:
        raise ModelError("the model's name is empty; see 'depthcli models list'")
    if not _is_path(name):
        for root in roots():
            place = place_at(root / name) or place_at(root / f"{name}{_ONNX_SUFFIX}")
            if place:
                return place
    place = place_at(Path(name))
    if place:
        return place
    if _is_path(name):
        raise ModelError(f"no model at {name!r}; give an .onnx file or a folder with {CARD_NAME}")
    raise ModelError(f"no model named {name!r}; see 'depthcli models list', or give a path")


def roots() -> tuple[Path, ...]:
    """Folders that hold models: the variable's, the user's, the bundled ones, a checkout's."""
    package = Path(__file__).resolve().parents[1]
    folders = [*_variable_roots(), data_folder() / "models", package / "_bundled"]
    if (package.parent / "pyproject.toml").is_file():
        folders.append(package.parent / "models")
    return tuple(folders)


def user_root() -> Path:
    """The folder that takes models of your own: the variable's first, else the user's."""
    return next(iter(_variable_roots()), data_folder() / "models")


def list_places() -> Iterator[tuple[str, Place]]:
    """Each model of the catalog with its name, by name; the first folder that has a name wins."""
    found: dict[str, Place] = {}
    for root in roots():
        children = sorted(root.iterdir()) if root.is_dir() else []
        for child in children:
            place = None if child.name.startswith(".") else place_at(child)
            if place:
                found.setdefault(child.name.removesuffix(_ONNX_SUFFIX), place)
    yield from sorted(found.items())


def read_model(place: Place) -> Model:
    """Read and check a model.

    Raises:
        ModelError: no card, damaged, external data, or a checksum that differs.
    """
    card = _read_card(place.card) if place.card else None
    path = _onnx_path(place, card)
    data = _read(path, _MAX_BYTES)
    sha256 = hashlib.sha256(data).hexdigest()
    if card:
        check_file(card, path, len(data), sha256)
    onnx_file.refuse_external_data(data, str(path))
    embedded = onnx_file.metadata(data, str(path)).get(METADATA_KEY)
    if card is None:
        if embedded is None:
            raise ModelError(
                f"{path} has no card; put {path.stem}{_CARD_SUFFIX} beside it, "
                "or export it with 'depthcli export-onnx'"
            )
        card = ModelCard.from_json(embedded, where=f"card inside {path}")
    return Model(path=path, card=card, sha256=sha256, data=data)


def read_onnx(path: Path) -> bytes:
    """The bytes of a complete ONNX file whose weights are all inside.

    Raises:
        ModelError: it is not one.
    """
    data = _read(path, _MAX_BYTES)
    onnx_file.refuse_external_data(data, str(path))
    onnx_file.metadata(data, str(path))
    return data


def read_card(path: Path) -> bytes:
    """The text of a card's file.

    Raises:
        ModelError: it cannot be read, or is too large for a card.
    """
    return _read(path, _MAX_CARD_BYTES)


def _variable_roots() -> list[Path]:
    return [Path(part) for part in os.environ.get(MODELS_VARIABLE, "").split(os.pathsep) if part]


def _is_path(name: str) -> bool:
    separators = {os.sep, os.altsep or os.sep}
    return name.endswith(_ONNX_SUFFIX) or name in {".", ".."} or any(s in name for s in separators)


def place_at(path: Path) -> Place | None:
    """The model at a path, a folder with a card or an ONNX file; None if there is none."""
    if (path / CARD_NAME).is_file():
        return Place(onnx=None, card=path / CARD_NAME)
    if path.suffix == _ONNX_SUFFIX and path.is_file():
        beside = path.with_name(path.stem + _CARD_SUFFIX)
        return Place(onnx=path, card=beside if beside.is_file() else None)
    return None


def _onnx_path(place: Place, card: ModelCard | None) -> Path:
    if place.onnx:
        return place.onnx
    if card is None or card.file is None:
        raise ModelError(f"{place.path}: file is missing; name the model's ONNX file in the card")
    return place.path.with_name(card.file)


def _read_card(path: Path) -> ModelCard:
    return ModelCard.from_json(read_card(path), where=str(path))


def _read(path: Path, max_bytes: int) -> bytes:
    try:
        size = path.stat().st_size
        if not 0 < size <= max_bytes:
            state = "empty" if size == 0 else f"too large ({size} bytes)"
            raise ModelError(f"{path} is {state}; download or export the model again")
        return path.read_bytes()
    except OSError as error:
        what = "check its name and its folder" if error.errno == ENOENT else "restore the model"
        raise ModelError(f"cannot read {path}: {error.strerror}; {what}") from error


def check_file(card: ModelCard, path: Path, size: int, sha256: str) -> None:
    """Compare a file with what its card promises.

    Args:
        card: promises of size and checksum count, if it makes them.
        path: what messages call the file.
        size: in bytes.
        sha256: 64 hex digits.

    Raises:
        ModelError: it is another file.
    """
    again = "download or export the model again"
    if card.size_bytes is not None and card.size_bytes != size:
        raise ModelError(f"{path} has {size} bytes, its card says {card.size_bytes}; {again}")
    if card.sha256 is not None and card.sha256 != sha256:
        raise ModelError(f"{path} has another checksum than its card says; {again}")
