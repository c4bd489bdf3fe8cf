"""What a depth file says of itself besides its pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING

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
        # Reading PNG need not wait for OpenEXR.
        from depthcli.io.exr_files import read_exr_texts  # noqa: PLC0415

        texts = read_exr_texts(path)
    else:
        return {}
    return {k.removeprefix(_PREFIX): v for k, v in texts.items() if k.startswith(_PREFIX)}
