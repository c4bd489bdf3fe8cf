"""The origin of init weights, for model cards and for comparing runs."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

from depthcli.errors import CheckpointError

_HASH_LENGTH = 16


def weights_origin(paths: Sequence[Path]) -> str:
    """Names and the first 16 digits of SHA-256 of the files whose mean a run starts from.

    "" for no files.

    Raises:
        CheckpointError: a file cannot be read.
    """
    try:
        names = [f"{path.name} {_digest(path)}" for path in paths]
    except OSError as error:
        raise CheckpointError(f"{error.filename} cannot be read: {error.strerror}") from error
    return f"mean of {', '.join(names)}" if len(names) > 1 else "".join(names)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:_HASH_LENGTH]
