"""Known depth of the frames of a video: the same for all, or of each by its number or time."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import Anchor
from depthcli.core.options import AnchorsFit, Rule
from depthcli.errors import InputError
from depthcli.io.depth.anchors import COLUMNS, SUFFIXES, AnchorFiles, numbers_of, read_known_depth
from depthcli.io.storage.paths import path_of, read_bytes
from depthcli.io.tables import CsvTable

_LAST_NUMBER = re.compile(r"(\d+)\D*$", re.ASCII)
_OUTPUT = ".depth"  # end of the stems of the outputs of ``convert``
_FRAME, _TIME_S = "frame", "time_s"
_RULES = {
    _FRAME: Rule("the number of a frame", lambda n: 0 <= n < 1e12 and n == int(n)),  # noqa: PLR2004
    _TIME_S: Rule("seconds from the first frame", lambda s: abs(s) < 1e9),  # noqa: PLR2004
}
_Points = AnchorPoints | Path


class FrameAnchors:
    """Known depth of each frame of a video; thread-safe.

    A folder has a file for each frame, whose name ends in the number of the frame. A table has a
    column ``frame`` or ``time_s``, or is of all frames, as any other file and a list of points.

    Attributes:
        paths: its files.
    """

    def __init__(
        self, stated: AnchorFiles | tuple[Anchor, ...], fit: AnchorsFit | None = None
    ) -> None:
        """List the folder, or read the file."""
        self._stated, self._fit, self.paths = stated, fit, list[Path]()
        self._of_all: AnchorPoints | None = None
        self._by_number: Mapping[int, _Points] = {}
        self._by_time_s: Mapping[float, AnchorPoints] = {}
        if isinstance(stated, tuple):
            self._of_all = AnchorPoints.of(stated)
            return
        path = path_of(stated.path)
        self.paths = [path]
        if path.is_dir():
            self._by_number = files = _numbered_files(path)
            self.paths = [*files.values()]
        elif path.suffix.lower() == ".csv":
            self._read_table(path, stated)
        else:
            self._of_all = stated.read()

    def of_frame(self, number: int, time_s: float, within_s: float) -> AnchorPoints | None:
        """The points of a frame; None if it has none.

        Points of the nearest time count, if it is at most ``within_s`` away.
        """
        found: _Points | None = self._of_all or self._by_number.get(number)
        if self._by_time_s:
            times_s = list(self._by_time_s)
            at = bisect_left(times_s, time_s)
            nearest_s = min(times_s[max(0, at - 1) : at + 1], key=lambda at_s: abs(at_s - time_s))
            found = self._by_time_s[nearest_s] if abs(nearest_s - time_s) <= within_s else None
        if isinstance(found, Path) and isinstance(self._stated, AnchorFiles):
            found = read_known_depth(found, self._stated)
        return replace(found, fit=self._fit) if isinstance(found, AnchorPoints) else None

    def states(self) -> list[object]:
        """What the depth of the frames depends on, for a fingerprint."""
        files = [(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in self.paths]
        return [self._stated, self._fit, files]

    def _read_table(self, path: Path, stated: AnchorFiles) -> None:
        table = CsvTable(read_bytes(path), str(path))
        key = next((name for name in _RULES if name in table.columns), None)
        if key is None:
            self._of_all = read_known_depth(path, stated)
            return
        rows = numbers_of(table, {key: _RULES[key], **COLUMNS})
        each = {k: AnchorPoints.of_table(rows[rows[:, 0] == k, 1:]) for k in np.unique(rows[:, 0])}
        if key == _FRAME:
            self._by_number = {int(number): points for number, points in each.items()}
        else:
            self._by_time_s = {float(time_s): points for time_s, points in each.items()}


def _numbered_files(folder: Path) -> dict[int, Path]:
    """The files of known depth in a folder by the last number in their names."""
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        number = _LAST_NUMBER.search(path.stem.removesuffix(_OUTPUT))
        if path.suffix.lower() not in SUFFIXES or number is None:
            continue
        at = int(number[1])
        if at in found:
            raise InputError(f"{found[at]} and {path} are both of frame {at}", "remove one")
        found[at] = path
    if not found:
        advice = f"name its files by numbers, such as 000012{SUFFIXES[0]} for frame 12"
        raise InputError(f"{folder} has no known depth of any frame", advice)
    return found
