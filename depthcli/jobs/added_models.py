"""The user's folder of models: its names, and removing what was added."""

import re
from pathlib import Path

from depthcli.errors import OutputError, UsageError
from depthcli.io.storage.atomic_folder import workspace
from depthcli.io.storage.user_folders import check_home
from depthcli.models import locations
from depthcli.models.catalog import file_of_card
from depthcli.models.locations import ModelLocation

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_ADDED_FILE = re.compile(r"model-[0-9a-f]{12}\.onnx")
_LITTER = (".DS_Store", "._", ".depthcli-")  # of file managers, and of runs that were killed


def valid_name(name: str) -> str:
    """A name that a model may have.

    Raises:
        UsageError: it cannot be the name of a folder, or would be taken for a path.
    """
    if not _NAME.fullmatch(name) or name.endswith(".onnx"):
        raise UsageError(
            f"{name!r} is not a valid model name; use letters, digits, '.', '_' and "
            "'-', beginning with a letter or digit"
        )
    return name


def folder_to_add(name: str, *, force: bool) -> Path:
    """The folder of a new model.

    Raises:
        UsageError: a model has the name and ``force`` is not given, the folder is a link, or it
            holds other files than those of a model.
        OutputError: the folder cannot be read.
    """
    target = locations.user_root() / name
    check_home(target)
    taken = next((p for n, p in locations.list_locations() if n == name), None)
    if taken is not None and not force:
        raise UsageError(
            f"a model named {name!r} already exists ({taken.path}); give another --name, or --force"
        )
    if target.is_symlink():
        raise UsageError(f"{target} is a link; remove it first: depthcli models remove {name}")
    if target.is_dir():
        _check_only_model(target, "give another --name")
    return target


def added_model(name: str) -> tuple[Path, ModelLocation]:
    """Folder and files of a model that was added.

    Raises:
        UsageError: it is not in the user's folder, or its folder holds other files, too.
    """
    folder = locations.user_root() / valid_name(name)
    location = locations.location_at(folder) or locations.location_at(
        folder.with_name(f"{folder.name}.onnx")
    )
    if location is None:
        raise UsageError(
            f"{name!r} is not among the models in {locations.user_root()}; only those are removed"
        )
    if location.onnx is None and not folder.is_symlink():
        _check_only_model(folder, "move them away, or delete the folder yourself")
    return folder, location


def remove_model(name: str) -> Path:
    """Delete a model that was added.

    Args:
        name: as in the list of models.

    Returns:
        The path that was removed.

    Raises:
        UsageError: it is not in the user's folder, or its folder holds other files, too.
        OutputError: it cannot be deleted.
    """
    folder, location = added_model(name)
    try:
        if location.onnx is not None:  # a file, beside which a folder may have the same name
            for file in filter(None, location):
                file.unlink()
        elif folder.is_symlink():
            folder.unlink()
        else:
            with workspace(folder.parent) as work:
                folder.rename(work / folder.name)
    except OSError as error:
        raise OutputError(f"cannot remove {folder}: {error.strerror}") from error
    return location.onnx or folder


def _check_only_model(folder: Path, advice: str) -> None:
    """Check that replacing or removing a folder loses nothing but a model, such as a checkpoint."""
    of_model = {locations.CARD_NAME, file_of_card(folder / locations.CARD_NAME)}
    try:
        names = sorted(path.name for path in folder.iterdir())
    except OSError as error:
        raise OutputError(f"cannot read {folder}: {error.strerror}") from error
    others = [
        name
        for name in names
        if not (name in of_model or _ADDED_FILE.fullmatch(name) or name.startswith(_LITTER))
    ]
    if others:
        raise UsageError(f"{folder} also holds {', '.join(others[:3])}; {advice}")
