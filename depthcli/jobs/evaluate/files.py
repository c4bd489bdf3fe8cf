"""The output files of an evaluation: CSV table, figures, HTML page."""

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
    """Paths of the files to write; None for those that are not."""

    csv: Path | None = None  #: the table
    figures: Path | None = None  #: folder for the figures
    html: Path | None = None  #: table and figures in one file

    def check(self, inputs: Iterable[str | Path | None]) -> None:
        """Check the paths before the evaluation.

        Args:
            inputs: files that must not be replaced, and folders in which only an earlier report may
                be replaced.

        Raises:
            UsageError: an input would be replaced, both files are the same, or a folder is a file
                or a file a folder.
        """
        if self.csv is not None and self.html is not None and is_same_file(self.csv, self.html):
            raise UsageError(f"--csv and --html are one file, {self.csv}; name two")
        if self.figures is not None and self.figures.is_file():
            raise UsageError(f"--figures {self.figures} is a file; name a folder")
        sources = [Path(source) for source in inputs if source is not None]
        data = [source.resolve() / part for source in sources for part in ("rgb", "depth")]
        if self.figures is not None and any(map(self.figures.resolve().is_relative_to, data)):
            raise UsageError(f"--figures {self.figures} is among the inputs; name another folder")
        for path, start in ((self.csv, b"name,"), (self.html, b"<!doctype html>")):
            if path is not None and path.is_dir():
                raise UsageError(f"{path} is a folder; name a file")
            if path is None or not any(_is_input(path, source) for source in sources):
                continue
            with path.open("rb") as file:
                is_report = file.read(len(start)) == start
            if not is_report:
                raise UsageError(f"{path} is an input and is not overwritten; name another file")

    def write(self, page: Page, table_csv: str, figures: Sequence[Figure]) -> Iterator[Path]:
        """Write the files.

        Yields:
            The path of each figure, once it is written.

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


def _is_input(path: Path, source: Path) -> bool:
    """Whether a file exists and is the source or in it."""
    is_below = path.resolve().is_relative_to(source.resolve())
    return path.is_file() and (is_below or is_same_file(path, source))
