"""What an evaluation leaves on the disk: table, sheets of pictures, and both in one page."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from depthcli.errors import UsageError
from depthcli.evaluation.reports.figures import Figure
from depthcli.evaluation.reports.html import html_page
from depthcli.evaluation.reports.text import Page
from depthcli.io.storage.atomic import atomic_path, is_same_file, write_text


@dataclass(frozen=True, slots=True)
class EvaluationFiles:
    """Which files are wanted; None for those that are not."""

    csv: Path | None = None  #: the table
    figures: Path | None = None  #: folder for the sheets
    html: Path | None = None  #: table and sheets in one file

    def check(self, inputs: Iterable[str | Path | None]) -> None:
        """Refuse what cannot be written, before anything is measured.

        Args:
            inputs: files, which are not replaced, nor is what is in a folder and no earlier report.

        Raises:
            UsageError: an input would be replaced, two files are one, or a folder is a file.
        """
        if self.csv is not None and self.html is not None and is_same_file(self.csv, self.html):
            raise UsageError(f"--csv and --html are one file, {self.csv}; name two")
        if self.figures is not None and self.figures.is_file():
            raise UsageError(f"--figures {self.figures} is a file; name a folder")
        sources = [Path(source) for source in inputs if source is not None]
        for path, start in ((self.csv, b"name,"), (self.html, b"<!doctype html>")):
            if path is not None and path.is_dir():
                raise UsageError(f"{path} is a folder; name a file")
            if path is None or not any(_is_read(path, source) for source in sources):
                continue
            with path.open("rb") as file:
                is_report = file.read(len(start)) == start
            if not is_report:
                raise UsageError(f"{path} is an input and is not overwritten; name another file")

    def write(self, page: Page, table_csv: str, figures: Sequence[Figure]) -> Iterator[Path]:
        """Write them.

        Yields:
            Each sheet, once it is there.

        Raises:
            OutputError: a file cannot be written.
        """
        if self.csv is not None:
            write_text(table_csv, self.csv)
        if self.figures is not None:
            for figure in figures:
                path = self.figures / f"{figure.name}.png"
                with atomic_path(path) as temporary:
                    temporary.write_bytes(figure.png)
                yield path
        if self.html is not None:
            write_text(html_page(page, figures), self.html)


def _is_read(path: Path, source: Path) -> bool:
    """Whether a file is there, and is the source or in it."""
    is_below = path.resolve().is_relative_to(source.resolve())
    return path.is_file() and (is_below or is_same_file(path, source))
