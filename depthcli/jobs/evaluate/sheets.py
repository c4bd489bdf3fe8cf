"""Sample pictures and the HTML page of an evaluation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.evaluation.reports.figures import PICTURES, choose, draw_figures
from depthcli.evaluation.reports.html import html_page
from depthcli.io.storage.atomic import atomic_path, write_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from depthcli.core.progress import Progress
    from depthcli.evaluation.nyu import EvalTask
    from depthcli.evaluation.predictors.base import Predictor
    from depthcli.evaluation.reports.figures import Figure


def positions_of(task: EvalTask, ids: str | None) -> tuple[int, ...]:
    """Positions of the pictures to show.

    Args:
        task: what is compared.
        ids: ids between commas; None for some of every type of scene.

    Raises:
        UsageError: an id is not among the pictures that are compared.
    """
    named = [name.strip() for name in ids.split(",") if name.strip()] if ids else []
    return choose(task, named, PICTURES)


def figures_of(
    task: EvalTask,
    positions: Sequence[int],
    predictors: Sequence[Predictor],
    titles: Sequence[str],
    progress: Progress,
) -> tuple[Figure, ...]:
    """The sheets in gray and in colour; none without predictors."""
    if not predictors:
        return ()
    return draw_figures(task, positions, predictors, titles, progress=progress)


def write_figures(figures: Sequence[Figure], folder: Path, *, quiet: bool) -> None:
    """Write each as a PNG.

    Raises:
        OutputError: a file cannot be written.
    """
    for figure in figures:
        path = folder / f"{figure.name}.png"
        with atomic_path(path) as temporary:
            temporary.write_bytes(figure.png)
        if not quiet:
            console.note(str(path))


def write_page(
    path: Path,
    title: str,
    subtitle: str,
    table: Sequence[Sequence[str]],
    notes: Sequence[str],
    figures: Sequence[Figure],
) -> None:
    """Write the HTML page; the first row of the table is its header.

    Raises:
        OutputError: the file cannot be written.
    """
    header, *rows = table
    write_text(html_page(title, subtitle, header, rows, notes, figures), path)
