"""Options of a batch, and the task and the result of one input, which can be pickled."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import Intrinsics
from depthcli.core.validation import fingerprint
from depthcli.errors import InputError, UsageError
from depthcli.io import manifest
from depthcli.io.depth.anchors import read_known_depth
from depthcli.io.formats.table import Format
from depthcli.io.listing.folder import InputFile, RealPaths, is_archive, is_video
from depthcli.io.manifest import Rows
from depthcli.io.storage.atomic import Guard, is_same_file
from depthcli.io.storage.objects import masked
from depthcli.io.storage.paths import path_of
from depthcli.jobs.batch.plan import BatchPlan
from depthcli.jobs.image import failure_reason
from depthcli.jobs.outputs import Destination, Kind, MapOptions
from depthcli.video.formats import COUNTERPARTS, VideoFormat


@dataclass(frozen=True, slots=True)
class BatchOptions(MapOptions):
    """Options of processing an input."""

    formats: tuple[Format, ...] = (Format.PNG16,)  #: output formats, each once
    column: str | None = None  #: of archives, the one with the images; None for the only one
    overwrite: bool = False  #: whether outputs may replace files of other programs

    def points_for(self, task: BatchTask) -> AnchorPoints | None:
        """The known depth of an image; None if there is none for any, InputError for this one."""
        image, stated = path_of(task.input.path), self.anchors
        if isinstance(stated, tuple) or stated.is_by_image:
            return self.known_points(image)
        file = stated.file_for(task.input.name, shares_stem=task.shares_stem, picture=image)
        if any(is_same_file(output, file) for output in task.outputs.values()):
            raise InputError(f"{file} is its known depth", "choose another {out}")
        stated = replace(stated, camera=stated.camera.of_image(task.intrinsics))
        return replace(read_known_depth(file, stated), fit=self.anchors_fit)


@dataclass(frozen=True, slots=True)
class BatchResult:
    """The result of an input."""

    row: manifest.ManifestRow  #: its row in the manifest
    is_kept: bool = False  #: whether the outputs of an earlier run were still valid


@dataclass(frozen=True, slots=True)
class BatchTask:
    """One input to process."""

    input: InputFile  #: the file
    #: path of each format of images or videos; a sequence's has ``%06d`` in its name
    outputs: Mapping[Any, Path]
    earlier: manifest.ManifestRow | None = None  #: the row of an earlier run; None if it has none
    is_listed: bool = False  #: whether the earlier run made outputs of these names
    shares_stem: bool = False  #: whether another image has its name but for the suffix
    intrinsics: Intrinsics | None = None  #: its own camera; None for that of the batch

    @property
    def input_path(self) -> str:
        """Full path of the input, or its URI without password and signature."""
        try:
            return str(path_of(self.input.path).absolute())
        except UsageError:  # a listed URI that cannot be used, as its problem says
            return masked(self.input.path)

    def key(self, batch: manifest.CacheKey) -> manifest.CacheKey:
        """Model and options that its outputs depend on: those of the batch, and its own camera."""
        if self.intrinsics is None:
            return batch
        return replace(batch, options_sha256=fingerprint(batch.options_sha256, self.intrinsics))

    def reusable_row(
        self, out: Path, sha256: str, batch: manifest.CacheKey, points: AnchorPoints | None = None
    ) -> manifest.ManifestRow | None:
        """The earlier row, if processing the input again would give the same outputs.

        ``sha256`` is the checksum of the input, and depth would be fitted to ``points``. UsageError
        if the outputs are those of another file, which is still there.
        """
        row, now = self.earlier, (manifest.OK, sha256, self.key(batch))
        if row is None:
            return None
        if row.input_sha256 != sha256:  # a copy of the folder resumes the batch
            self._check_same_input(row, out)
        if not self.is_listed or (row.status, row.input_sha256, row.key) != now:
            return None
        if (row.anchors and row.anchors.sha256) != (points.sha256() if points else None):
            return None
        return row if all(manifest.is_intact(out, file) for file in row.outputs) else None

    def check_outputs(self, *, overwrite: bool) -> None:
        """Check the outputs for writing; OutputError if one is the input, or not depthcli's."""
        guard = Guard.of([path_of(self.input.path)], overwrite=overwrite or self.is_listed)
        guard.check(*self.outputs.values())

    def _check_same_input(self, row: manifest.ManifestRow, out: Path) -> None:
        """Refuse to replace the outputs of a file of the same name in another folder."""
        if row.input_path is None or not row.outputs or row.input_path == self.input_path:
            return
        other = path_of(str(row.input_path))
        with suppress(OSError):
            if other.exists() and not is_same_file(path_of(self.input.path), other):
                taken = out / row.outputs[0].path
                problem = f"{taken} is the output for {other}, not for {self.input_path}"
                advice = "choose another {out}, or delete the manifest to replace such outputs"
                raise UsageError(problem, advice)

    def result(
        self,
        batch: manifest.CacheKey,
        start_s: float,
        sha256: str | None,
        error: str | None = None,
        **facts: Any,  # noqa: ANN401 - further fields of the row
    ) -> BatchResult:
        """The result of the input, begun at a time of ``perf_counter``; no checksum if unread."""
        row = manifest.ManifestRow(
            input=self.input.name,
            status=manifest.FAILED if error else manifest.OK,
            key=self.key(batch),
            seconds=time.perf_counter() - start_s,
            input_sha256=sha256,
            input_path=self.input_path,
            error=error,
            **facts,
        )
        return BatchResult(row)

    def failed_result(
        self, error: Exception, batch: manifest.CacheKey, start_s: float, sha256: str | None
    ) -> BatchResult:
        """The result of an input that failed; raises a UsageError, which is about the batch."""
        if isinstance(error, UsageError):
            raise error
        return self.result(batch, start_s, sha256, failure_reason(error))


class TaskBuilder:
    """Makes the task of each input of a batch."""

    def __init__(self, plan: BatchPlan, formats: Iterable[Format]) -> None:
        """Begin with the formats of images; videos get their counterparts, archives hold them."""
        chosen = tuple(formats)
        videos = tuple(COUNTERPARTS[which] for which in chosen if which in COUNTERPARTS)
        self._plan = plan
        self._images = Destination(Kind.FOLDER, plan.out, chosen)
        self._videos = Destination(Kind.FOLDER, plan.out, videos)

    def check_conflicts(self) -> None:
        """UsageError if an output would replace an input; files of a list can lie anywhere."""
        places, taken = RealPaths(), set(self._plan.inputs_in_out)
        inside = os.path.realpath(self._plan.out)
        folders = map(Path, map(os.path.realpath, self._plan.folders()))
        if not all(folder.is_relative_to(inside) for folder in folders):
            # Through a link, outputs go to another folder, which may contain inputs.
            taken.update(*(places.all_of(file.path) for file in self._plan.inputs))
        for file in self._plan.inputs if taken else ():
            for path in self.of(file).values():
                if places.of(path) in taken:
                    problem = f"{path}, the output for {file.name}, is an input"
                    raise UsageError(problem, "choose another {out}")

    def of(self, file: InputFile) -> dict[Format, Path] | dict[VideoFormat, Path]:
        """Paths of the outputs of an input."""
        base = self._plan.out / self._plan.names.base(file.name)
        if is_video(file.name):
            return self._videos.outputs(base)
        outputs = self._images.outputs(base)
        if not is_archive(file.name):
            return outputs
        return {next(iter(outputs)): base.with_name(f"{base.name}.depth{Path(file.name).suffix}")}

    def task(self, file: InputFile, rows: Rows) -> BatchTask:
        """The task for an input, given the rows of earlier batches."""
        plan, row, outputs = self._plan, rows.row(file.name), self.of(file)
        names = {path.relative_to(plan.out).as_posix() for path in outputs.values()}
        # Frames of a video have the name of their sequence.
        sub = re.compile(r"(?<=\.depth\.)\d{6,}(?=\.\w+$)" if is_video(file.name) else r"(?!)")
        earlier = {sub.sub("%06d", one.path) for one in row.outputs} if row else set()
        return BatchTask(
            input=file,
            outputs=outputs,
            earlier=row,
            is_listed=row is not None and names == earlier,
            shares_stem=plan.stems.is_shared(file.name),
            intrinsics=plan.intrinsics.get(file.name),
        )
