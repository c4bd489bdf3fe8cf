"""The origin of initial weights, for model cards and for comparing runs."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

_HASH_LENGTH = 16


def weights_origin(paths: Sequence[Path]) -> str:
    """Names and the first 16 digits of SHA-256 of the files whose mean a run starts from.

    "" for no files.
    """
    names = [
        f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()[:_HASH_LENGTH]}"
        for path in paths
    ]
    return f"mean of {', '.join(names)}" if len(names) > 1 else "".join(names)
