"""Finding the files of a model by name or path, without reading them."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from depthcli.core.text import short_repr
from depthcli.errors import ModelError
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.io.storage.user_folders import data_folder
from depthcli.models.ready_cards import ready_names

DEFAULT_MODEL = "default"
MODELS_VARIABLE = "DEPTHCLI_MODELS"
CARD_NAME = "card.json"
CARD_SUFFIX = ".card.json"
_ONNX_SUFFIX = ".onnx"


class ModelLocation(NamedTuple):
    """The files of a model, which have not been read yet."""

    onnx: Path | None  #: the ONNX file; None where only its card names it
    card: Path | None  #: the card's file; None if the card is inside the ONNX file

    @property
    def path(self) -> Path:
        """The file that messages name."""
        path = self.card or self.onnx
        if path is None:
            raise ValueError("a location has a model or a card")
        return path


def find_location(name_or_path: str | os.PathLike[str] | None = None) -> ModelLocation:
    """Find a model without reading it.

    Raises:
        ModelError: there is no such model, or the search failed.
    """
    try:
        return _find(name_or_path)
    except OSError as error:  # a name that is too long, a host that cannot be reached
        name = safe_name(os.fspath(name_or_path or ""))
        raise ModelError(f"no model at {short_repr(name)}: {error.strerror}") from error


def _find(name_or_path: str | os.PathLike[str] | None) -> ModelLocation:
    path = path_of(DEFAULT_MODEL if name_or_path is None else name_or_path)
    name = DEFAULT_MODEL if name_or_path is None else os.fspath(name_or_path)
    if not name:
        raise ModelError("the model's name is empty; see 'depthcli models list'")
    if not _is_path(name):
        for root in roots():
            location = location_at(root / name) or location_at(root / f"{name}{_ONNX_SUFFIX}")
            if location:
                return location
    location = location_at(path)
    if location:
        return location
    if _is_path(name):
        raise ModelError(
            f"no model at {safe_name(name)!r}; give an .onnx file or a folder with {CARD_NAME}"
        )
    raise ModelError(f"no model named {name!r}; {_advice(name)}")


def roots() -> tuple[Path, ...]:
    """Folders of models: the environment variable's, the user's, the bundled, a checkout's."""
    package = Path(__file__).resolve().parents[1]
    folders = [*_variable_roots(), data_folder() / "models", package / "_bundled"]
    if (package.parent / "pyproject.toml").is_file():
        folders.append(package.parent / "models")
    return tuple(folders)


def user_root() -> Path:
    """The folder for installed models: the first of the environment variable, else the user's."""
    return next(iter(_variable_roots()), data_folder() / "models")


def list_locations() -> Iterator[tuple[str, ModelLocation]]:
    """The models of the catalog, sorted by name; the first folder that has a name counts."""
    found: dict[str, ModelLocation] = {}
    for root in roots():
        children = sorted(root.iterdir()) if root.is_dir() else []
        for child in children:
            location = None if child.name.startswith(".") else location_at(child)
            if location:
                found.setdefault(child.name.removesuffix(_ONNX_SUFFIX), location)
    yield from sorted(found.items())


def location_at(path: Path) -> ModelLocation | None:
    """The model at a path, a folder with a card or an ONNX file; None if there is none."""
    if (path / CARD_NAME).is_file():
        return ModelLocation(onnx=None, card=path / CARD_NAME)
    if path.suffix == _ONNX_SUFFIX and path.is_file():
        beside = path.with_name(path.stem + CARD_SUFFIX)
        return ModelLocation(onnx=path, card=beside if beside.is_file() else None)
    return None


def _variable_roots() -> list[Path]:
    folders = os.environ.get(MODELS_VARIABLE, "")
    if "://" in folders:
        raise ModelError(
            f"{MODELS_VARIABLE} is {short_repr(folders)}: it takes folders of this machine; "
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
