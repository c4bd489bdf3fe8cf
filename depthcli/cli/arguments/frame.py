"""The depth file that ``probe`` and ``convert`` read: a map, or one frame of a depth video."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.errors import InputError, UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from depthcli.core.types import DepthMap

VIDEO_SUFFIX = ".mkv"

FrameOption = Annotated[
    int | None,
    typer.Option(min=0, help="The frame of a depth video (.mkv) to read, from 0."),
]


def read_map(path: Path, *, scale: float | None, frame: int | None) -> DepthMap:
    """A depth map from any file that depthcli writes.

    Args:
        path: the file.
        scale: steps a metre of a PNG or a video; None for what the file states.
        frame: number of the frame in a video, counted in this file; None for other files.

    Raises:
        InputError: missing, damaged, without depth, or shorter than that.
        UsageError: a video without the number of a frame, or a number or a scale for another file.
    """
    from depthcli.io.depth.read import read_depth

    check_scale(path, scale)
    if path.suffix.lower() == VIDEO_SUFFIX:
        if frame is None:
            raise UsageError(f"{path} is a video; say which frame with --frame, 0 for the first")
        return _frame(path, scale, frame)
    if frame is not None:
        raise UsageError(f"--frame is for depth videos (.mkv), but {path} is not one; remove it")
    return read_depth(path, png_scale=scale)


def check_scale(path: Path, scale: float | None) -> None:
    """Refuse a scale for a file that holds metres as they are.

    Raises:
        UsageError: it is neither a PNG nor a depth video.
    """
    if scale is not None and path.suffix.lower() not in {".png", VIDEO_SUFFIX}:
        raise UsageError(
            f"a scale is for PNG and depth videos (.mkv), but {path} is neither; remove it"
        )


def _frame(path: Path, scale: float | None, number: int) -> DepthMap:
    from depthcli.io.video.depth import DepthVideo

    count = 0
    for count, depth in enumerate(DepthVideo(path, scale=scale), start=1):
        if count > number:
            return depth
    raise InputError(f"{path} has no frame {number}; its last one is {count - 1}")
