"""What manifests tell: how many inputs failed, which, and why."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from depthcli.errors import UsageError
from depthcli.io.manifest.files import open_rows, row_files
from depthcli.io.manifest.journal import Journal, Rows, known_rows
from depthcli.io.manifest.row import FAILED, ManifestFormat, Row
from depthcli.io.manifest.rows_folder import rows_folder
from depthcli.io.manifest.shard import WHOLE


@dataclass(frozen=True, slots=True)
class ModelInputs:
    """How many inputs one model did."""

    model: str  #: its name
    model_sha256: str  #: checksum of its file
    version: str  #: of depthcli
    inputs: int


@dataclass(frozen=True, slots=True)
class Summary:
    """The rows of a manifest, added up."""

    inputs: int
    failed: int
    outputs: int  #: files
    output_bytes: int
    seconds: float  #: from opening each input to its last output, in all
    models: tuple[ModelInputs, ...]


def rows_of(path: Path) -> Rows:
    """The latest row of each input.

    Args:
        path: an output folder, with all that its shards left; or one manifest.

    Raises:
        UsageError: there is no manifest.
    """
    if path.is_dir() and path.suffix != f".{ManifestFormat.PARQUET}":
        rows = known_rows(path)
        if not rows.is_there:
            raise UsageError(f"no manifest in {path}; name the output folder of a batch")
        return rows
    try:
        return Rows([open_rows(path)], WHOLE)
    except OSError as error:
        raise UsageError(f"cannot read the manifest {path}: {error.strerror}") from error


def summarize(rows: Rows) -> Summary:
    """The sums of all rows."""
    models: Counter[tuple[str, str, str]] = Counter()
    failed = outputs = output_bytes = 0
    seconds = 0.0
    for row in rows:
        failed += row.status == FAILED
        outputs += len(row.outputs)
        output_bytes += sum(file.bytes for file in row.outputs)
        seconds += row.seconds
        models[row.origin.model, row.origin.model_sha256, row.origin.version] += 1
    by_model = tuple(ModelInputs(*model, inputs) for model, inputs in models.items())
    return Summary(models.total(), failed, outputs, output_bytes, round(seconds, 6), by_model)


def failed_rows(rows: Rows) -> Iterator[Row]:
    """The rows of inputs that failed."""
    return (row for row in rows if row.status == FAILED)


def merge(folder: Path, form: ManifestFormat | None = None) -> Path:
    """Make one manifest of all that shards and killed batches left in an output folder.

    Args:
        folder: the output folder.
        form: of the manifest; None for that of the one that is there, or JSON lines.

    Returns:
        The manifest.

    Raises:
        UsageError: there is none, or a batch is at work there.
        OutputError: it cannot be written; what was there stays.
    """
    place = rows_folder(folder)
    if not row_files(place.path, WHOLE):
        raise UsageError(f"no manifest in {folder}; name the output folder of a batch")
    journal = Journal(place.path, form=form)
    journal.finish(None)
    place.finish()
    return folder / journal.manifest.name
