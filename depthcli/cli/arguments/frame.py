"""The frame of a depth video that ``probe`` and ``convert`` read."""

from __future__ import annotations

from typing import Annotated

import typer

FrameOption = Annotated[
    int | None,
    typer.Option(min=0, help="The frame of a depth video (.mkv) to read, from 0."),
]
