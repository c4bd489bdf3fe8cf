"""What an evaluation leaves on the disk: table, sheets of pictures, and both in one page."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from depthcli.evaluation.reports.figures import Figure
from depthcli.evaluation.reports.html import html_page
from depthcli.evaluation.reports.text import Page
from depthcli.io.storage.atomic import atomic_path, write_text


@dataclass(frozen=True, slots=True)
class EvaluationFiles:
    """Which files are wanted; None for those that are not."""

    csv: Path | None = None  #: the table
    figures: Path | None = None  #: folder for the sheets
    html: Path | None = None  #: table and sheets in one file

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
