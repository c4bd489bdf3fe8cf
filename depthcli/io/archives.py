"""Data sets as they are distributed: tar shards (webdataset) and Parquet with images inside.

Images are read from them, and depth is written to a file of the same kind.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from depthcli.core.camera import Intrinsics
from depthcli.errors import InputError, UsageError
from depthcli.io import listing, media
from depthcli.io.formats.table import Format

_ROWS = 64  # of a row group that is written
_IMAGES = (Format.PNG16, Format.PREVIEW)


class Member(NamedTuple):
    """One image of an archive."""

    name: str  #: its path in the archive, or the number of its row
    data: bytes | None  #: None if the row holds no image
    camera: Intrinsics | None = None  #: its own camera; None if none is stated
    origin: Any = None  #: of a bag, the message that it is from

    def output_name(self, format_: Format) -> str:
        """Its name with the suffix of a format."""
        # The keys of webdataset keep "./", which a path would not.
        return os.path.splitext(self.name)[0] + format_.facts.suffix  # noqa: PTH122


Write: TypeAlias = Callable[[Member, Mapping[Format, bytes]], object]  #: of one image


def holds_images(path: Path, column: str | None = None) -> bool:
    """Whether a file is an archive, and no Parquet list of paths."""
    if not _is_parquet(path):
        return media.is_archive(path.name) and path.is_file()
    if not path.is_file():
        return False
    with listing.open_parquet(path) as file:
        columns, names = _image_columns(file), file.schema_arrow.names
    return column in columns if column else bool(columns) and listing.PATHS not in names


def members(path: Path, column: str | None = None) -> Iterator[Member]:
    """The images of an archive, in its order.

    Of a webdataset sample, that is its first image whose name has one suffix (``0001.jpg``).

    The column is that of Parquet with the images; of tar, it is the part of the names after the
    first dot, such as ``rgb.png``. InputError if it cannot be read, or has no such images.
    """
    try:
        yield from (_parquet_members if _is_parquet(path) else _tar_members)(path, column)
    except UsageError as error:  # one archive does not stop the others
        raise InputError(error.message) from error


def _is_parquet(path: Path) -> bool:
    return path.suffix.lower() == ".parquet"


def _image_columns(file: Any) -> list[str]:  # noqa: ANN401 - pyarrow's own
    """Columns of bytes, or of groups with a field ``bytes`` as ``datasets`` writes them."""
    kinds = {field.name: str(field.type) for field in file.schema_arrow}
    starts = ("binary", "large_binary", "struct<bytes:", "struct<path: string, bytes:")
    return [name for name, kind in kinds.items() if kind.startswith(starts)]


def _tar_members(path: Path, column: str | None) -> Iterator[Member]:
    import tarfile  # noqa: PLC0415 - as others import this module for its types

    last = None
    try:
        with tarfile.open(path, "r:*") as archive:
            for entry in archive:
                folder, _, name = entry.name.rpartition("/")
                key, _, extension = name.partition(".")
                is_chosen = extension == column if column else "." not in extension
                is_image = media.is_media(name) or media.is_exr(name)
                if entry.isfile() and is_chosen and is_image and (folder, key) != last:
                    last, file = (folder, key), archive.extractfile(entry)
                    yield Member(entry.name, file.read() if file else None)
            raw: Any = archive.fileobj
            raw.seek(archive.offset)
            if raw.read(tarfile.BLOCKSIZE) != tarfile.NUL * tarfile.BLOCKSIZE:
                raise InputError(f"{path} is damaged: its end is missing", "copy it again")
            if last is None:
                advice = "if their names have several suffixes, give {column}, such as rgb.png"
                raise InputError(f"{path} holds no image", advice)
    except (tarfile.TarError, EOFError) as error:
        raise InputError(f"{path} is damaged: {error}") from error


def _parquet_members(path: Path, column: str | None) -> Iterator[Member]:
    with listing.open_parquet(path) as file:
        columns = _image_columns(file)
        if (column or len(columns) != 1) and column not in columns:
            names = ", ".join(columns) or "none"
            raise UsageError(f"columns with images in {path}: {names}", "name one with {column}")
        row = 0
        for batch in file.iter_batches(_ROWS, columns=[column or columns[0]]):
            for value in batch.column(0).to_pylist():
                data = value.get("bytes") if isinstance(value, dict) else value
                name = isinstance(value, dict) and value.get("path")
                yield Member(str(name or f"{row:06d}"), data)
                row += 1


@contextmanager
def archive_writer(path: Path, formats: tuple[Format, ...]) -> Iterator[Write]:
    """Write an archive; its suffix chooses the kind.

    In tar, the depth of ``0001.jpg`` is ``0001.depth.png``, with the suffix of each format. Parquet
    has a column for each format and a row for each image; failed ones are null.
    """
    with _parquet_writer(path, formats) if _is_parquet(path) else _tar_writer(path) as write:
        yield write


@contextmanager
def _tar_writer(path: Path) -> Iterator[Write]:
    import tarfile  # noqa: PLC0415

    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT) as archive:

        def write(member: Member, files: Mapping[Format, bytes]) -> None:
            for format_, data in files.items():
                entry = tarfile.TarInfo(member.output_name(format_))
                entry.size = len(data)
                archive.addfile(entry, BytesIO(data))

        yield write


@contextmanager
def _parquet_writer(path: Path, formats: tuple[Format, ...]) -> Iterator[Write]:
    import pyarrow as pa  # noqa: PLC0415 - in an extra
    import pyarrow.parquet as pq  # noqa: PLC0415

    columns = {format_: "depth" if format_ is Format.PNG16 else str(format_) for format_ in formats}
    kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    features = {columns[format_]: {"_type": "Image"} for format_ in formats if format_ in _IMAGES}
    schema = pa.schema([(name, kind) for name in columns.values()]).with_metadata(
        {"huggingface": json.dumps({"info": {"features": features}})} if features else None
    )
    rows: list[dict[str, Any]] = []
    with pq.ParquetWriter(path, schema) as file:

        def write(member: Member, files: Mapping[Format, bytes]) -> None:
            rows.append(
                {
                    columns[format_]: {"bytes": data, "path": member.output_name(format_)}
                    for format_, data in files.items()
                }
            )
            if len(rows) == _ROWS:
                flush()

        def flush() -> None:
            file.write_table(pa.Table.from_pylist(rows, schema))
            rows.clear()

        yield write
        flush()
