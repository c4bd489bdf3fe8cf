"""A column of Rich's progress bar."""

from __future__ import annotations

from rich.progress import ProgressColumn, Task
from rich.text import Text


class Rate(ProgressColumn):
    """Steps a second."""

    def render(self, task: Task) -> Text:
        """What the column shows; empty before the first step."""
        return Text(f"{task.speed:.1f}/s" if task.speed else "")
