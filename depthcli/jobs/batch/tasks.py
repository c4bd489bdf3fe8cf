"""Options of a batch, and the task and the result of one input, which can be pickled."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.core.camera import Intrinsics
from depthcli.core.options import SceneLayout
from depthcli.core.validation import fingerprint
from depthcli.errors import InputError, OutputError, UsageError
from depthcli.io import listing, manifest, media
from depthcli.io.formats.table import Format
from depthcli.io.guard import Guard
from depthcli.io.storage.atomic import identity_of
from depthcli.io.storage.objects import masked
from depthcli.io.storage.paths import path_of, read_bytes
from depthcli.jobs.batch.plan import BatchPlan
from depthcli.jobs.image import failure_reason
from depthcli.jobs.outputs import Destination, Kind, MapOptions
from depthcli.known.points import KnownDepth
from depthcli.known.sources import read_file, read_topic
from depthcli.video.formats import COUNTERPARTS, VideoFormat

if TYPE_CHECKING:
    from depthcli.core.types import Frame


@dataclass(frozen=True, slots=True)
class BatchOptions(MapOptions):
    """Options of processing an input."""

    formats: tuple[Format, ...] = (Format.PNG16,)  #: output formats, each once
    column: str | None = None  #: of archives, the one with the images; None for the only one
    overwrite: bool = False  #: whether outputs may replace files of other programs
    layout: SceneLayout | None = None  #: whose names outputs have; None for those of depthcli
    transforms: Path | None = None  #: nerfstudio's file, a copy of which states the depth

    @property
    def topic(self) -> str | None:
        """The topic of bags with known depth; None if there is none."""
        return None if isinstance(self.anchors, tuple) else self.anchors.topic

    def points_for(self, task: BatchTask) -> KnownDepth | None:
        """The known depth of an image; None if there is none for any, InputError for this one."""
        image, source = path_of(task.input.path), self.anchors
        if isinstance(source, tuple) or source.is_by_image:
            return self.known_points(image)
        file = source.file_for(task.input.name, shares_stem=task.shares_stem, image=image)
        if identity_of(file) in map(identity_of, task.outputs.values()):
            raise InputError(f"{file} is its known depth", "choose another {out}")
        source = replace(source, camera=source.camera.of_image(task.intrinsics))
        return replace(read_file(file, source), fit=self.anchors_fit)

    def topic_facts(self) -> tuple[object, ...]:
        """What the known depth of a topic depends on beside the bag, for a fingerprint."""
        if isinstance(self.anchors, tuple) or self.topic is None:
            return ()
        extrinsics = self.anchors.extrinsics
        text = read_bytes(extrinsics).hex() if extrinsics else None
        return self.anchors, self.anchors_fit, text

    def points_of(self, origin: Any, camera: Intrinsics) -> KnownDepth | None:  # noqa: ANN401
        """The known depth of an image of a bag; None if there is none for any."""
        if isinstance(self.anchors, tuple) or self.topic is None:
            return None
        return replace(read_topic(origin, self.anchors, camera), fit=self.anchors_fit)

    def read(self, path: Path | None, data: bytes | None, name: str = "standard input") -> Frame:
        """An image, as in other commands; InputError if programs for scenes see it turned."""
        frame = MapOptions.read(self, path, data, name)
        if frame.orientation != 1 and (self.layout or self.transforms):
            problem = "its EXIF turns the image, which programs for scenes ignore"
            raise InputError(problem, "remove it: exiftool -Orientation= FILE")
        return frame


@dataclass(frozen=True, slots=True)
class BatchResult:
    """The result of an input."""

    row: manifest.ManifestRow  #: its row in the manifest
    is_kept: bool = False  #: whether the outputs of an earlier run were still valid


@dataclass(frozen=True, slots=True)
class BatchTask:
    """One input to process."""

    input: listing.InputFile  #: the file
    #: path of each format of images or videos; a sequence's has ``%06d`` in its name
    outputs: Mapping[Any, Path]
    earlier: manifest.ManifestRow | None = None  #: the row of an earlier run; None if it has none
    is_listed: bool = False  #: whether the earlier run made outputs of these names
    #: the row of an earlier input, not of this batch, that has one of the outputs; None if none has
    rival: manifest.ManifestRow | None = None
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
        self, out: Path, sha256: str, batch: manifest.CacheKey, points: KnownDepth | None = None
    ) -> manifest.ManifestRow | None:
        """The earlier row, if processing the input again would give the same outputs.

        ``sha256`` is the checksum of the input, and depth would be fitted to ``points``. UsageError
        if the outputs are those of another file, which is still there.
        """
        row, now = self.earlier, (manifest.OK, sha256, self.key(batch))
        if row is None:
            return None
        if row.input_sha256 != sha256 and (other := self._owner(row)):
            advice = "choose another {out}, or delete the manifest to replace such outputs"
            raise UsageError(f"{self.input_path} would replace the outputs of {other}", advice)
        if not self.is_listed or (row.status, row.input_sha256, row.key) != now:
            return None
        if (row.anchors and row.anchors.sha256) != (points.sha256() if points else None):
            return None
        sums = ((manifest.checksum(out / f.path), (f.bytes, f.sha256)) for f in row.outputs)
        return row if all(now == then for now, then in sums) else None

    def check_outputs(self, *, overwrite: bool) -> None:
        """Check the outputs for writing.

        OutputError if one is the input, that of another input, or not depthcli's.
        """
        may_replace = overwrite or self.is_listed
        guard = Guard.of([path_of(self.input.path)], overwrite=may_replace)
        guard.check(*self.outputs.values())
        if self.rival and not may_replace and (other := self._owner(self.rival)):
            problem = f"{self.input_path} would replace the outputs of {other}"
            raise OutputError(problem, "process both in one batch, or choose another {out}")

    def _owner(self, row: manifest.ManifestRow) -> Path | None:
        """The input of an earlier row with outputs, if it is another file and still there.

        In a copy of the folder, it is the same file under another path.
        """
        if row.input_path is None or not row.outputs or row.input_path == self.input_path:
            return None
        other = path_of(str(row.input_path))
        with suppress(OSError):
            if other.exists() and identity_of(path_of(self.input.path)) != identity_of(other):
                return other
        return None

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

    def __init__(
        self, plan: BatchPlan, options: BatchOptions, rows: manifest.Rows | None = None
    ) -> None:
        """Begin with the rows of earlier batches.

        Videos get the counterparts of the formats of images, archives hold them.
        """
        formats, self._layout = options.formats, options.layout
        videos = tuple(COUNTERPARTS[format_] for format_ in formats if format_ in COUNTERPARTS)
        self._plan, self._rows = plan, rows or manifest.Rows(())
        self._images = Destination(Kind.FOLDER, plan.out, formats)
        self._videos = Destination(Kind.FOLDER, plan.out, videos)
        self._rivals = {path: row.input for row in self._rows.others for path in _output_paths(row)}

    def of(self, file: listing.InputFile) -> dict[Format, Path] | dict[VideoFormat, Path]:
        """Paths of the outputs of an input."""
        base = self._plan.out / self._plan.names.base(file.name)
        if media.is_video(file.name):
            return self._videos.outputs(base)
        outputs = self._images.outputs(base)
        if self._layout is SceneLayout.GSPLAT:
            return outputs | {Format.PNG16: base.with_name(f"{base.name}.png")}
        if self._layout is SceneLayout.COLMAP:
            return outputs | {Format.COLMAP: self._plan.out / f"{file.name}.geometric.bin"}
        if not media.is_archive(file.name):
            return outputs
        return {next(iter(outputs)): base.with_name(f"{base.name}.depth{Path(file.name).suffix}")}

    def check_conflicts(self) -> None:
        """UsageError if an output would replace an input, also through a link."""
        places, inputs = listing.RealPaths(), self._plan.like_outputs
        for file in self._plan.inputs if inputs else ():
            for path in self.of(file).values():
                if places.of(path) in inputs:
                    problem = f"{path}, the output for {file.name}, is an input"
                    raise UsageError(problem, "choose another {out}")

    def task(self, file: listing.InputFile) -> BatchTask:
        """The task for an input."""
        plan, row, outputs = self._plan, self._rows.row(file.name), self.of(file)
        paths = {path.relative_to(plan.out).as_posix() for path in outputs.values()}
        rivals = (self._rivals[path] for path in paths if path in self._rivals)
        return BatchTask(
            input=file,
            outputs=outputs,
            earlier=row,
            is_listed=row is not None and paths == _output_paths(row),
            rival=next(filter(None, map(self._rows.row, rivals)), None),
            shares_stem=file.name in plan.same_stem,
            intrinsics=plan.intrinsics.get(file.name),
        )


def _output_paths(row: manifest.ManifestRow) -> set[str]:
    """Paths of a row's outputs; frames of a video have the name of their sequence."""
    paths = {file.path for file in row.outputs}
    return {_FRAME.sub("%06d", path) for path in paths} if media.is_video(row.input) else paths


_FRAME = re.compile(r"(?<=\.depth\.)\d{6,}(?=\.\w+$)")
