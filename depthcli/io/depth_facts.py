"""What a depth file says of itself besides its pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.errors import InputError
from depthcli.io.decode import read_bytes
from depthcli.io.png_text import read_text

if TYPE_CHECKING:
    from pathlib import Path

_PREFIX = "depthcli:"


def stated_facts(path: Path) -> dict[str, str]:
    """Unit, scale, kind, model and so on, as the file's writer stated them.

    Args:
        path: a PNG or EXR; other files state nothing.

    Returns:
        Name -> text; empty if another program wrote the file.

    Raises:
        InputError: missing or damaged.
    """
    suffix = path.suffix.lower()
    if suffix == ".png":
        texts = read_text(read_bytes(path))
    elif suffix == ".exr":
        texts = _exr_header(path)
    else:
        return {}
    return {k.removeprefix(_PREFIX): v for k, v in texts.items() if k.startswith(_PREFIX)}


def _exr_header(path: Path) -> dict[str, str]:
    import OpenEXR  # noqa: PLC0415 - reading PNG need not wait for it

    try:
        header = OpenEXR.File(str(path), header_only=True).header()
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(f"{path} is not an EXR file that can be read") from error
    return {name: value for name, value in header.items() if isinstance(value, str)}
