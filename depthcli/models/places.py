"""Where models lie, found by name or path; nothing is read yet."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from depthcli.core.text import shown
from depthcli.errors import ModelError
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.io.storage.user_folders import data_folder
from depthcli.models.ready_cards import ready_names

DEFAULT_MODEL = "default"
MODELS_VARIABLE = "DEPTHCLI_MODELS"
CARD_NAME = "card.json"
CARD_SUFFIX = ".card.json"
_ONNX_SUFFIX = ".onnx"


class Place(NamedTuple):
    """Where a model lies; nothing has been read yet."""

    onnx: Path | None  #: the ONNX file; None where only its card names it
    card: Path | None  #: the card's file; None if the card is inside the ONNX file

    @property
    def path(self) -> Path:
        """The file that stands for the model in messages."""
        path = self.card or self.onnx
        if path is None:
            raise ValueError("a place has a model or a card")
        return path


def find_place(name_or_path: str | os.PathLike[str] | None = None) -> Place:
    """Where a model lies, without reading it.

    Raises:
        ModelError: there is no such model, or it cannot be looked for.
    """
    try:
        return _find(name_or_path)
    except OSError as error:  # a name that is too long, a host that is not reached
        name = safe_name(os.fspath(name_or_path or ""))
        raise ModelError(f"no model at {shown(name)}: {error.strerror}") from error


def _find(name_or_path: str | os.PathLike[str] | None) -> Place:
    path = path_of(DEFAULT_MODEL if name_or_path is None else name_or_path)
    name = DEFAULT_MODEL if name_or_path is None else os.fspath(name_or_path)
    if not name:
        raise ModelError("the model's name is empty; see 'depthcli models list'")
    if not _is_path(name):
        for root in roots():
            place = place_at(root / name) or place_at(root / f"{name}{_ONNX_SUFFIX}")
            if place:
                return place
    place = place_at(path)
    if place:
        return place
    if _is_path(name):
        raise ModelError(
            f"no model at {safe_name(name)!r}; give an .onnx file or a folder with {CARD_NAME}"
        )
    raise ModelError(f"no model named {name!r}; {_advice(name)}")


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


def place_at(path: Path) -> Place | None:
    """The model at a path, a folder with a card or an ONNX file; None if there is none."""
    if (path / CARD_NAME).is_file():
        return Place(onnx=None, card=path / CARD_NAME)
    if path.suffix == _ONNX_SUFFIX and path.is_file():
        beside = path.with_name(path.stem + CARD_SUFFIX)
        return Place(onnx=path, card=beside if beside.is_file() else None)
    return None


def _variable_roots() -> list[Path]:
    folders = os.environ.get(MODELS_VARIABLE, "")
    if "://" in folders:
        raise ModelError(
            f"{MODELS_VARIABLE} is {shown(folders)}: it takes folders of this machine; "
            "a model at a URI is given with --model"
        )
    return [Path(folder) for folder in folders.split(os.pathsep) if folder]


def _advice(name: str) -> str:
    if name in ready_names():
        return f"download its weights and run: depthcli models add FILE --card {name}"
    return "see 'depthcli models list', or give a path"


def _is_path(name: str) -> bool:
    separators = {os.sep, os.altsep or os.sep}
    return name.endswith(_ONNX_SUFFIX) or name in {".", ".."} or any(s in name for s in separators)
