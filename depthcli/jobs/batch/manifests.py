"""Reading, summarizing and merging manifests."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from depthcli.errors import Message, UsageError, os_errors_as
from depthcli.io import manifest
from depthcli.io.manifest import Journal, Rows, known_rows


@dataclass(frozen=True, slots=True)
class Summary:
    """Sums over the rows of a manifest."""

    inputs: int
    failed: int
    outputs: int  #: files
    output_bytes: int
    seconds: float  #: processing time of all inputs, each from opening it to its last output
    #: name and checksum of each model, version of depthcli, and number of inputs it processed
    models: tuple[dict[str, str | int], ...]


def read_rows(path: Path) -> Rows:
    """The latest row of each input in a manifest, or in an output folder with all its shards."""
    with os_errors_as(UsageError, f"cannot read the manifest {path}"):
        rows = known_rows(path) if path.is_dir() else Rows([path])
    if not rows.has_files:
        raise UsageError(f"no manifest in {path}", "name the output folder of a batch")
    return rows


def damage(path: Path) -> Message | None:
    """The problem of lines that are no rows in a manifest, or in those of a folder."""
    files = manifest.row_files(path) if path.is_dir() else [path]
    for file in files:
        damaged = () if manifest.is_journal(file) else manifest.damaged_lines(file)
        if damaged:
            return Message(
                f"{file}: line {damaged[0]} is no row, and {len(damaged) - 1} others are none",
                "remove them, and the next batch processes their inputs again",
            )
    return None


def summarize(rows: Rows) -> Summary:
    """Sums over all rows."""
    models: Counter[tuple[str, str, str]] = Counter()
    failed = outputs = output_bytes = 0
    seconds = 0.0
    for row in rows:
        failed += row.status == manifest.FAILED
        outputs += len(row.outputs)
        output_bytes += sum(file.bytes for file in row.outputs)
        seconds += row.seconds
        models[row.key.model, row.key.model_sha256, row.key.version] += 1
    names = ("model", "model_sha256", "version")
    by_model = tuple(dict(zip(names, m, strict=True)) | {"inputs": n} for m, n in models.items())
    return Summary(models.total(), failed, outputs, output_bytes, round(seconds, 6), by_model)


def merge_manifests(folder: Path) -> Path:
    """Merge the manifests of shards and the journals of killed batches; returns the manifest.

    UsageError if there is none, or a batch is running there.
    """
    files = manifest.row_files(folder)
    if not files:
        raise UsageError(f"no manifest in {folder}", "name the output folder of a batch")
    if problem := damage(folder):
        raise UsageError(problem)
    journal = Journal(folder)
    journal.finish(None)
    return journal.manifest
