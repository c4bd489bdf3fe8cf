"""The folder of a run: names of its files, and the error if it cannot be written."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from depthcli.errors import OutputError, TrainingError

CHECKPOINT = "last.ckpt"
METRICS_LOG = "metrics.jsonl"


@contextmanager
def write_errors(folder: Path) -> Iterator[None]:
    """Raise failed writes in the block as a TrainingError.

    Raises:
        TrainingError: a file in the folder cannot be written.
    """
    try:
        yield
    except (OSError, OutputError) as error:
        cause = error if isinstance(error, OSError) else error.__cause__
        reason = getattr(cause, "strerror", None) or str(error)
        is_full = getattr(cause, "errno", None) in {errno.ENOSPC, errno.EDQUOT}
        advice = "free some space or give another {out}" if is_full else "give another {out}"
        raise TrainingError(f"cannot write to {folder} ({reason})", advice) from error
