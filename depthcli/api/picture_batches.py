"""Taking pictures from a caller's iterator in batches, with an error at its position."""

from __future__ import annotations

import itertools
import os
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from depthcli.core.types import Frame
from depthcli.io.images.read import frame_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from depthcli.io.images.read import Picture


class PictureBatch(NamedTuple):
    """Pictures that are processed together."""

    pictures: list[Picture]
    error: Exception | None  #: what ended the caller's iterator after them, if anything did

    def frames(self, white_level: int | None) -> tuple[list[Frame], Exception | None]:
        """The pictures before the first one that cannot be used, and the error after them."""
        found: list[Frame] = []
        try:
            for picture in self.pictures:
                level = None if isinstance(picture, Frame) else white_level
                found.append(frame_of(picture, level))
        except Exception as error:  # noqa: BLE001 - raised at its position
            return found, error
        return found, self.error


def picture_batches(
    pictures: Iterable[Picture], size: int, white_level: int | None
) -> Iterator[PictureBatch]:
    """Up to ``size`` pictures at a time.

    Pixels in memory are copied here, since the caller may overwrite a buffer, or close a PIL
    picture, before the batch is processed; files are not read.
    """
    rest, error = iter(pictures), None
    while error is None:
        some: list[Picture] = []
        try:
            for picture in itertools.islice(rest, size):
                some.append(_own(picture, white_level))  # noqa: PERF401 - kept at an error
        except Exception as problem:  # noqa: BLE001 - raised at its position
            error = problem
        if not some and error is None:
            return
        yield PictureBatch(some, error)


def _own(picture: Picture, white_level: int | None) -> Picture:
    if isinstance(picture, (bytearray, memoryview)):
        return bytes(picture)
    if isinstance(picture, (str, bytes, os.PathLike)):
        return picture
    frame = frame_of(picture, white_level)
    return replace(frame, pixels=frame.pixels.copy()) if frame is picture else frame
