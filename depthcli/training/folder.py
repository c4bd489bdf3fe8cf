"""The folder of a run: what its files are called, and what is said when it cannot be written."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from depthcli.errors import OutputError, TrainingError

CHECKPOINT = "last.ckpt"
METRICS_LOG = "metrics.jsonl"


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turn a file that cannot be written into an error that says so.

    Raises:
        TrainingError: the system refuses.
    """
    try:
        yield
    except (OSError, OutputError) as error:
        cause = error if isinstance(error, OSError) else error.__cause__
        reason = getattr(cause, "strerror", None) or str(error)
        raise TrainingError(
            f"cannot write to {folder} ({reason}): free some space or give another --out"
        ) from error
