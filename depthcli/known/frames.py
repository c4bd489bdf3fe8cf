"""Known depth of the frames of a video: the same for all, or of each by its number or time."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Lock

import numpy as np

from depthcli.core.camera import Anchor
from depthcli.core.options import DepthFit, Rule
from depthcli.errors import InputError
from depthcli.io.listing import CsvTable
from depthcli.io.storage.paths import path_of, read_bytes
from depthcli.known.files import OUTPUT, SUFFIXES, KnownDepthFiles
from depthcli.known.points import KnownDepth
from depthcli.known.sources import COLUMNS, numbers_of, read_file, read_known_depth
from depthcli.video.numbering import times_ns

_LAST_NUMBER = re.compile(r"(\d+)\D*$", re.ASCII)
_FRAME, _TIME_S = "frame", "time_s"
_RULES = {
    _FRAME: Rule("the number of a frame", lambda n: 0 <= n < 1e12 and n == int(n)),  # noqa: PLR2004
    _TIME_S: Rule("seconds from the first frame", lambda s: abs(s) < 1e9),  # noqa: PLR2004
}
_Points = KnownDepth | Path


class KnownDepthOfFrames:
    """Known depth of each frame of a video; thread-safe.

    A folder has a file for each frame, whose name ends in the number of the frame. A table has a
    column ``frame`` or ``time_s``, or is of all frames, as any other file and a list of points.

    Attributes:
        paths: its files, and that of extrinsics.
    """

    def __init__(
        self,
        source: KnownDepthFiles | tuple[Anchor, ...],
        fit: DepthFit | None = None,
        within_s: float | None = None,
    ) -> None:
        """List the folder, or read the file; there may be neither.

        ``within_s`` is the largest distance from a frame in seconds; None for half a frame.
        """
        self._source, self._fit, self._within_s = source, fit, within_s
        self.paths = list[Path]()
        self._of_all: KnownDepth | None = None
        self._each: Mapping[float, _Points] = {}
        self._is_timed = False
        self._read = lru_cache(maxsize=2)(read_file)
        self._reading = defaultdict[Path, Lock](Lock)
        if isinstance(source, tuple):
            self._of_all = KnownDepth.of(source) if source else None
            return
        path = path_of(source.path)
        self.paths = [path]
        if path.is_dir():
            files = _numbered_files(path)
            self._each, self.paths = dict(sorted(files.items())), [*files.values()]
        elif path.suffix.lower() == ".csv":
            self._read_table(path, source)
        else:
            self._of_all = read_known_depth(source)
        if source.extrinsics:
            self.paths.append(source.extrinsics)

    def of_frame(
        self, number: int, time_s: float, rate: float, numbers_a_second: float | None = None
    ) -> KnownDepth | None:
        """The points of a frame of a video of ``rate`` frames a second; None if it has none.

        ``numbers_a_second`` is of images that are numbered by their times.
        """
        points: _Points | None = self._of_all
        if self._each:
            keys, at = list(self._each), time_s if self._is_timed else number
            after = bisect_left(keys, at)
            nearest = min(keys[max(0, after - 1) : after + 1], key=lambda key: abs(key - at))
            within_s = 0.5 / rate if self._within_s is None else self._within_s
            within = within_s if self._is_timed else within_s * (numbers_a_second or rate)
            points = self._each[nearest] if abs(nearest - at) <= within else None
        if isinstance(points, Path) and isinstance(self._source, KnownDepthFiles):
            with self._reading[points]:  # once for all frames near a scan
                points = self._read(points, self._source)
        return replace(points, fit=self._fit) if isinstance(points, KnownDepth) else None

    def states(self) -> list[object]:
        """What the depth of the frames depends on, for a fingerprint."""
        files = [(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in self.paths]
        return [self._source, self._fit, self._within_s, files]

    def _read_table(self, path: Path, files: KnownDepthFiles) -> None:
        table = CsvTable(read_bytes(path), str(path))
        key = next((name for name in _RULES if name in table.columns), None)
        if key is None:
            self._of_all = read_file(path, files)
            return
        rows = numbers_of(table, {key: _RULES[key], **COLUMNS})
        self._is_timed = key == _TIME_S
        self._each = {
            float(at): KnownDepth.of_table(rows[rows[:, 0] == at, 1:])
            for at in np.unique(rows[:, 0])
        }


def _numbered_files(folder: Path) -> dict[int, Path]:
    """The files of known depth in a folder by the last number in their names."""
    listed = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    names = {path: path.stem.removesuffix(OUTPUT) for path in listed}
    last = {path: match for path, name in names.items() if (match := _LAST_NUMBER.search(name))}
    numbers = times_ns([names[path] for path in last]) or [int(match[1]) for match in last.values()]
    files: dict[int, Path] = {}
    for path, at in zip(last, numbers, strict=True):
        if at in files:
            raise InputError(f"{files[at]} and {path} are both of frame {at}", "remove one")
        files[at] = path
    if not files:
        advice = f"name its files by numbers, such as 000012{SUFFIXES[0]} for frame 12"
        raise InputError(f"{folder} has no known depth of any frame", advice)
    return files
