"""Profiles on disk: options by name, one TOML file each."""

import json
import re
from collections.abc import Mapping
from pathlib import Path

from depthcli.errors import OutputError, UsageError
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.paths import check_home, config_folder, read_regular

Scalar = str | int | float | bool
Value = Scalar | list[Scalar]

_ADVICE = "set XDG_CONFIG_HOME to a folder that takes it"
_MAX_BYTES = 2**20
_SUFFIX = ".toml"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


def folder() -> Path:
    """The folder of the profiles."""
    return config_folder() / "profiles"


def profile_names() -> tuple[str, ...]:
    """Names of the saved profiles, sorted."""
    return tuple(sorted(path.stem for path in folder().glob(f"*{_SUFFIX}") if path.is_file()))


def profile_path(name: str) -> Path:
    """The path of a profile, which need not exist; a name that ends in ``.toml`` is a path itself.

    Raises:
        UsageError: the name is invalid.
    """
    if name.endswith(_SUFFIX):
        return Path(name)
    if not _NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} is not a valid profile name; use letters, digits, '.', '_' and '-', "
            "beginning with a letter or digit"
        )
    return folder() / f"{name}{_SUFFIX}"


def profile_text(name: str) -> str:
    """The TOML text of a profile.

    Raises:
        UsageError: there is no such profile, or it cannot be read.
    """
    path = profile_path(name)
    try:
        return read_regular(path, _MAX_BYTES).decode()
    except FileNotFoundError:
        names = ", ".join(profile_names())
        there = f"there are: {names}" if names else "'depthcli profile save' saves one"
        raise UsageError(f"no profile named {name!r}; {there}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"profile {path} cannot be read ({error}); save it again") from error


def read_profile(name: str) -> dict[str, Value]:
    """The options of a profile, by name without leading dashes.

    Raises:
        UsageError: there is no such profile, or it is not valid TOML of plain values.
    """
    import tomllib

    path = profile_path(name)
    try:
        values = tomllib.loads(profile_text(name))
    except (ValueError, RecursionError) as error:
        raise UsageError(f"profile {path} is not TOML: {error}; correct it") from error
    for key, value in values.items():
        parts = value if isinstance(value, list) else [value]
        if not all(isinstance(part, Scalar) for part in parts):
            raise UsageError(
                f"profile {path}: {key} must be text, a number, true, false or a list of these"
            )
    return values


def write_profile(name: str, values: Mapping[str, Value], *, force: bool) -> Path:
    """Save a profile.

    Returns:
        Its path.

    Raises:
        UsageError: the name is invalid, or taken and ``force`` is not set.
        OutputError: it cannot be written.
    """
    path = profile_path(name)
    if path.exists() and not force:
        raise UsageError(f"profile {name!r} already exists; give another name, or --force")
    check_home(path)
    lines = [f"{key} = {_toml(value)}\n" for key, value in values.items()]
    with atomic_path(path, advice=_ADVICE) as temporary:
        try:
            temporary.write_text("".join(lines), "utf-8")
        except UnicodeEncodeError as error:
            raise UsageError("a name that is not UTF-8 cannot be saved; rename the file") from error
    return path


def remove_profile(name: str) -> Path:
    """Delete a profile.

    Returns:
        The path that was removed.

    Raises:
        UsageError: there is no such profile.
        OutputError: it cannot be deleted.
    """
    profile_text(name)
    path = profile_path(name)
    try:
        path.unlink()
    except OSError as error:
        raise OutputError(f"cannot remove {path}: {error.strerror}") from error
    return path


def _toml(value: Value) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_toml(part) for part in value)}]"
    if isinstance(value, str):
        # A JSON string is a TOML string, except that TOML also requires this character escaped.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value)  # numbers are finite: the options refuse others
