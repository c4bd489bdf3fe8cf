"""Mapping inputs to the paths of their outputs."""

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from depthcli.errors import UsageError
from depthcli.io.formats.table import FORMATS, Format
from depthcli.io.listing.folder import InputFile, is_video
from depthcli.io.listing.real_paths import RealPaths
from depthcli.io.manifest.journal import Rows
from depthcli.io.manifest.row import Row
from depthcli.jobs.batch.input_plan import Plan
from depthcli.jobs.batch.suspects import has_crashed
from depthcli.jobs.batch.task import Task
from depthcli.video.formats import COUNTERPARTS, VIDEO_FORMATS, VideoFormat

_MAX_SAME = 1000


@dataclass(frozen=True, slots=True)
class OutputMap:
    """Maps each input of a batch to its outputs."""

    plan: Plan  #: all inputs
    formats: tuple[Format, ...]  #: formats for pictures; videos get their counterparts

    def check_conflicts(self) -> None:
        """Refuse outputs that would replace inputs; files of a list can lie anywhere.

        Raises:
            UsageError: an output is an input.
        """
        places, taken = RealPaths(), set(self.plan.inputs_in_out)
        inside = os.path.realpath(self.plan.out)
        folders = map(Path, map(os.path.realpath, self.plan.folders()))
        if not all(folder.is_relative_to(inside) for folder in folders):
            # Through a link, outputs go to another folder, which may contain inputs.
            taken.update(*(places.all_of(file.path) for file in self.plan.inputs))
        for file in self.plan.inputs if taken else ():
            for path in self.of(file).values():
                if places.of(path) in taken:
                    raise UsageError(
                        f"{path}, the output for {file.name}, is an input; choose another --out"
                    )

    def check_earlier(self, rows: Rows) -> None:
        """Check as far as sizes tell that no earlier output is that of another file.

        A batch of the same folder is known by its first rows; the others are not read twice.

        Raises:
            UsageError: one is, and that file is still there.
        """
        same = 0
        for file in self.plan.inputs:
            task: Task[Format] = Task(file, {}, rows.row(file.name))
            task.check_sizes(self.plan.out)
            same += task.earlier is not None and task.earlier.input_path == task.input_path
            if same == _MAX_SAME:
                return

    def of(self, file: InputFile) -> dict[Format, Path] | dict[VideoFormat, Path]:
        """Paths of the outputs of an input."""
        return self._of_video(file) if is_video(file.name) else self._of_picture(file)

    def picture(self, file: InputFile, rows: Rows) -> Task[Format]:
        """The task for a picture, given the rows of earlier batches."""
        outputs, row = self._of_picture(file), rows.row(file.name)
        has_names = row is not None and self._names(outputs.values()) == _made_names(row)
        if not has_names:
            file = self._unless_taken(file, outputs.values(), rows)
        shares_stem = self.plan.stems.is_shared(file.name)
        lens = self.plan.lenses.get(file.name)
        return Task(file, outputs, row, has_crashed(row), shares_stem, lens, has_names)

    def video(self, file: InputFile, rows: Rows) -> Task[VideoFormat]:
        """The task for a video, given the rows of earlier batches."""
        outputs, row = self._of_video(file), rows.row(file.name)
        has_names = row is not None and self._names(outputs.values()) == _sequence_names(row)
        if not has_names:
            file = self._unless_taken(file, outputs.values(), rows)
        lens = self.plan.lenses.get(file.name)
        return Task(file, outputs, row, has_crashed(row), lens=lens, has_names=has_names)

    def _unless_taken(self, file: InputFile, outputs: Iterable[Path], rows: Rows) -> InputFile:
        """The input, with a problem if its output is that of a file which is left out."""
        names = self._names(outputs)
        for other in self.plan.unlisted.get(file.name, ()):
            row = rows.row(other)
            for taken in names & (_made_names(row) | _sequence_names(row)) if row else ():
                return file._replace(
                    problem=f"{self.plan.out / taken} is the output for {other}, which "
                    "this batch leaves out; list both, or choose another --out"
                )
        return file

    def _names(self, outputs: Iterable[Path]) -> set[str]:
        return {path.relative_to(self.plan.out).as_posix() for path in outputs}

    def _of_picture(self, file: InputFile) -> dict[Format, Path]:
        base = self.plan.names.base(file.name)
        return {which: self.plan.out / (base + FORMATS[which].suffix) for which in self.formats}

    def _of_video(self, file: InputFile) -> dict[VideoFormat, Path]:
        base = self.plan.names.base(file.name)
        chosen = [COUNTERPARTS[which] for which in self.formats if which in COUNTERPARTS]
        return {which: self.plan.out / (base + VIDEO_FORMATS[which].suffix) for which in chosen}


def _made_names(row: Row) -> set[str]:
    """Names of the outputs of an earlier run, relative to the output folder."""
    return {file.path for file in row.outputs}


def _sequence_names(row: Row) -> set[str]:
    """The same for a video, whose frames have the name of their sequence: their number varies."""
    return {re.sub(r"(?<=\.depth\.)\d{6,}(?=\.\w+$)", "%06d", name) for name in _made_names(row)}
