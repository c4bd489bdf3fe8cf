"""How the progress of an evaluation looks."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli.cli.screen.progress import drawn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from depthcli.evaluation.nyu import Stage


@contextmanager
def stages(*, quiet: bool) -> Iterator[Stage]:
    """Progress on standard error: a bar on a terminal, lines elsewhere."""
    with drawn(silent=quiet, announces=True) as progress:

        def begin(what: str, steps: int) -> Callable[[], None]:
            advance = progress.begin(what, steps)
            return lambda: advance(1)

        yield begin
