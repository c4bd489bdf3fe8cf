"""One image from its frame to its outputs and warnings, as every command and Python make it.

``predict``, ``batch``, archives, ``serve``, the Python API and the frames of a video call
:class:`ImageJob`; they differ in where images come from, and in what a failure ends.
"""

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeAlias

from depthcli.core import types
from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import DepthcliError, OutputError, about, is_out_of_memory, os_errors_as
from depthcli.inference.pipeline import Pipeline, Prediction
from depthcli.inference.transforms import focal_warnings
from depthcli.io.formats.table import FORMATS, Format, WriterOptions, writer_of
from depthcli.io.storage.atomic import atomic_path, temporary_folder
from depthcli.io.stored.metadata import known_depth_fields, origin_fields
from depthcli.known.points import KnownDepth

_LOG = logging.getLogger(__name__)

Target: TypeAlias = Path | BinaryIO
"""Where an output goes: a file, which a guard has checked, or a stream."""


class ImageTask(NamedTuple):
    """An image that was read, and what becomes of it."""

    frame: Frame
    camera: Intrinsics = UNKNOWN_CAMERA  #: what is known of its camera
    points: KnownDepth | None = None  #: its known depth; None if it has none
    outputs: Mapping[Format, Target] = {}  #: target of each format; none to keep the map alone


class ImageResult(NamedTuple):
    """The depth of an image whose outputs are written."""

    depth: DepthMap  #: as it is displayed: of an EXR that of its display window
    whole: DepthMap  #: of every pixel of its frame
    warnings: tuple[str, ...]  #: about the image, its camera, depth and outputs; one line each
    shared: tuple[str, ...]  #: of the warnings, those that all images of this camera have

    def named_warnings(self, name: str) -> tuple[str, ...]:
        """The warnings for a list of several images: all but the shared ones begin with a name."""
        return tuple(text if text in self.shared else about(name, text) for text in self.warnings)


@dataclass(frozen=True, slots=True)
class ImageJob:
    """A loaded model and the options of outputs; thread-safe."""

    pipeline: Pipeline
    writing: WriterOptions = field(default_factory=WriterOptions)

    def run(self, task: ImageTask) -> ImageResult:
        """Predict one image and write its outputs.

        Raises:
            InputError: the camera or the known depth does not fit the image.
            ModelError: the network failed.
            OutputError: an output cannot be written.
        """
        begin_s = time.perf_counter()
        prediction = self._pipeline([task]).predict(task.frame, task.camera, task.points)
        _log(task, "depth", begin_s)
        return self._finish(task, prediction)

    def run_many(self, tasks: Sequence[ImageTask]) -> list[ImageResult | Exception]:
        """Do as :meth:`run` for several images, with one run of the network for those of a size.

        An error of an image stands in its place.
        """
        predictions = self._pipeline(tasks).predict_many(
            [task.frame for task in tasks],
            [task.camera for task in tasks],
            [task.points for task in tasks],
        )
        results = list[ImageResult | Exception]()
        for task, done in zip(tasks, predictions, strict=True):
            try:
                results.append(done if isinstance(done, Exception) else self._finish(task, done))
            except Exception as error:  # noqa: BLE001 - no image may stop the others
                results.append(error)
        return results

    def _pipeline(self, tasks: Sequence[ImageTask]) -> Pipeline:
        """The model; it estimates errors if an output needs them."""
        if self.writing.max_error is None and not any(Format.ERROR in t.outputs for t in tasks):
            return self.pipeline
        return Pipeline(self.pipeline.session, replace(self.pipeline.detail, error=True))

    def _finish(self, task: ImageTask, prediction: Prediction) -> ImageResult:
        frame, depth = task.frame, prediction.depth
        shared = () if task.points else focal_warnings(self.pipeline.card, task.camera)
        warnings = [*frame.warnings, *prediction.warnings, *shared]
        begin_s = time.perf_counter()
        for format_, target in task.outputs.items():
            warnings += write_output(self.writing, format_, depth, frame, target)
        _log(task, f"{len(task.outputs)} outputs", begin_s)
        displayed = types.displayed_depth(depth, frame.windows)
        return ImageResult(displayed, depth, tuple(dict.fromkeys(warnings)), shared)


def _log(task: ImageTask, what: str, begin_s: float) -> None:
    frame, seconds = task.frame, time.perf_counter() - begin_s
    facts = frame.path or "an image", frame.width, frame.height, what, seconds
    _LOG.debug("%s (%d×%d): %s in %.3f s", *facts)


def write_output(
    options: WriterOptions, format_: Format, depth: DepthMap, frame: Frame, target: Target
) -> tuple[str, ...]:
    """Write one format of an image's depth; returns warnings of one line.

    Depth is that of all pixels of the frame; only formats with a display window get the overscan.
    BrokenPipeError of a stream as it comes.
    """
    if isinstance(target, Path):
        with atomic_path(target) as temporary:
            return _write(options, format_, depth, frame, temporary)
    # The libraries of the formats write files only.
    with temporary_folder() as folder:
        path = folder / f"depth{Path(FORMATS[format_].suffix).suffix}"
        problem = f"cannot write a temporary file in {folder.parent}"
        with os_errors_as(OutputError, problem, "set TMPDIR to a folder with room"):
            warnings = _write(options, format_, depth, frame, path)
            data = path.read_bytes()
    with os_errors_as(OutputError, "cannot write standard output"):
        target.write(data)
        target.flush()
    return warnings


def _write(
    options: WriterOptions, format_: Format, depth: DepthMap, frame: Frame, path: Path
) -> tuple[str, ...]:
    if not format_.facts.has_overscan:
        depth, frame = types.displayed_depth(depth, frame.windows), types.displayed_frame(frame)
    if not (types.has_depth(depth.values[::16, ::16], depth.kind).any() or depth.valid.any()):
        raise OutputError("no pixel has depth, so nothing is written")
    return writer_of(format_, options).write(depth, path, frame)


def depth_facts(depth: DepthMap) -> dict[str, Any]:
    """Kind, unit, range and size of a map, its model and camera, for JSON."""
    return {
        "kind": depth.kind.value,
        "unit": depth.unit,
        **types.range_facts(depth),
        "width": depth.width,
        "height": depth.height,
        **origin_fields(depth),
        **known_depth_fields(depth),
    }


class FailedInput(NamedTuple):
    """An input that cannot be used, or whose outputs cannot be written."""

    name: str  #: the input, as the user wrote it
    error: DepthcliError  #: why


def failure_reason(error: Exception) -> str:
    """The reason why an input failed, in one line."""
    if isinstance(error, DepthcliError):
        return error.message
    if is_out_of_memory(error):
        return "does not fit into memory; make it smaller"
    if isinstance(error, OSError) and error.strerror:  # for example too many open files
        return ": ".join(filter(None, (error.filename and str(error.filename), error.strerror)))
    return f"unexpected {type(error).__name__}: {error}"
