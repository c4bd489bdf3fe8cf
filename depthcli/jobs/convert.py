"""Converting depth files, folders of them and depth videos, and measuring the round-trip error."""

import math
import os
import re
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import Self

import numpy as np

from depthcli.core import options, parallel, temporal, types
from depthcli.core.camera import UNKNOWN_CAMERA, CameraSource, Intrinsics
from depthcli.errors import DepthcliError, InputError, Message, UsageError
from depthcli.io import listing as folders
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.formats import preview, table
from depthcli.io.guard import Guard, is_own_image
from depthcli.io.images.read import read_image
from depthcli.io.listing import InputFile, NameFilter, Skipped
from depthcli.io.storage import atomic, paths
from depthcli.io.stored.depth import DepthReadOptions, StoredDepth, stated_range
from depthcli.io.stored.metadata import NORMALIZED
from depthcli.jobs import inspect, outputs
from depthcli.jobs.image import FailedInput, failure_reason
from depthcli.jobs.video.plan import LOCK_S
from depthcli.video import depth_video, formats, numbering
from depthcli.video.frames import FALLBACK_RATE, Timing, exact_rate
from depthcli.video.outputs import DepthFrame, video_file
from depthcli.video.source import stated_rate

_RULES = outputs.FormatRules(
    (), table.format_of, table.stem_of, table.FILE_SUFFIXES, of_pattern=table.format_of
)
_FRAME = r"(?i)\.depth\.\d{6,}$"  #: end of the stem of a numbered file, ``clip.depth.000001``
_OTHER_BIN = r"(?i)(?<!geometric)(?<!photometric)(?<!depth)\.bin$"
"""Files that have the suffix of COLMAP's depth maps and not their names."""


@dataclass(frozen=True, slots=True)
class ConvertRequest:
    """Source, target and options of a conversion."""

    #: a depth map, a depth video, a pattern for numbered files, or a folder, searched recursively
    source: str
    #: the file, to which a missing suffix is added; a pattern or a video for frames; or a folder
    target: str
    format: table.Format | None = None  #: of the target; None to take it from the suffix
    #: what the user states about the source
    stated: DepthReadOptions = field(default_factory=DepthReadOptions)
    camera: Intrinsics = UNKNOWN_CAMERA  #: in place of that of the source; depth is not changed
    reading: options.ReadOptions = options.AS_STATED  #: how the image is read
    image: str | None = None  #: for the colours of a point cloud, or beside a preview
    writing: table.WriterOptions = field(
        default_factory=table.WriterOptions
    )  #: options of the formats
    overwrite: bool = False  #: whether the target may replace a file of another program
    fps: Fraction | None = None  #: frames a second of numbered files; None for what they state


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """The error of the written file when it is read back, in the map's unit."""

    max_error: float  #: largest absolute error
    mean_error: float  #: mean absolute error
    lost: int  #: number of pixels that have no depth any more

    @classmethod
    def of(cls, depth: types.DepthMap, read_back: types.DepthMap) -> Self:
        """The errors between two maps of the same size."""
        both = depth.valid & read_back.valid
        error = np.abs(depth.values[both].astype(np.float64) - read_back.values[both])
        lost = int(depth.valid.sum() - both.sum())
        return cls(*(float(error.max()), float(error.mean())) if error.size else (0.0, 0.0), lost)


@dataclass(frozen=True, slots=True)
class ConvertResult:
    """The result of a conversion."""

    source: str  #: the input, as the user wrote it
    target: str  #: the file that was written
    depth: types.DepthMap  #: what was written, of an EXR its display window
    round_trip: RoundTrip | None  #: round-trip error; None for a format that is not read back
    warnings: tuple[str, ...]  #: one line each


def convert(request: ConvertRequest) -> ConvertResult:
    """Write a depth file in another format."""
    format_, path = target_of(request.target, request.format)
    stored = inspect.read_map(paths.path_of(request.source), request.stated)
    return _write_converted(stored, request, format_, path)


def _write_converted(
    stored: StoredDepth, request: ConvertRequest, format_: table.Format, path: Path
) -> ConvertResult:
    """Write a map that was read from the source of a request; raises the errors of `convert`."""
    displayed = stored.displayed
    colours = None if request.image is None else _colours(request, request.image, displayed)
    displayed = types.with_camera(_with_camera_of(colours, displayed), request.camera)
    views = {stored.frame.view, colours.view if colours else None} - {None}
    if len(views) > 1:
        problem = f"depth is of one eye ({stored.frame.view}) and {request.image} of the other"
        raise InputError(problem, "choose with {from_layer} and {layer}")
    depth, frame = displayed, colours
    if format_.facts.has_overscan:
        depth, frame = replace(stored.depth, provenance=displayed.provenance), stored.frame
    if not (depth.valid.any() or inspect.is_depth_video(paths.path_of(request.source))):
        raise InputError(f"{stored.name} has no pixel with depth, so nothing is written")
    inputs = [paths.path_of(name) for name in (request.source, request.image) if name is not None]
    Guard.of(inputs, overwrite=request.overwrite).check(path)
    with atomic.atomic_path(path) as temporary:
        writing = (
            _sidecar_options(request, stored) if format_ is table.Format.JSON else request.writing
        )
        warnings = table.writer_of(format_, writing).write(depth, temporary, frame)
        round_trip = None
        if format_.facts.is_readable:
            kind = DepthReadOptions(kind=options.DepthEncoding(depth.kind))
            round_trip = RoundTrip.of(depth, read_stored_depth(temporary, kind).depth)
    of_image = colours.warnings if colours else ()
    warnings = (*stored.warnings_with_scale("from_scale"), *of_image, *warnings)
    return ConvertResult(
        paths.safe_name(request.source), str(path), displayed, round_trip, warnings
    )


def target_of(target: str, format_: table.Format | None) -> tuple[table.Format, Path]:
    """Format of a converted map, the one asked for or that of the suffix, and its path."""
    destination = outputs.Destination.parse(target, () if format_ is None else (format_,), _RULES)
    if destination.path is None or destination.kind is outputs.Kind.FOLDER:
        folder = "" if target == outputs.STDIO else f"{target.rstrip('/')}/"
        raise UsageError(f"{target} is not a file", f"name one, for example {folder}depth.exr")
    return destination.formats[0], destination.path


def _sidecar_options(request: ConvertRequest, stored: StoredDepth) -> table.WriterOptions:
    """The options; by default, the sidecar of a 16-bit PNG states the scale of that PNG."""
    writing, scale = request.writing, stored.metadata.get("scale")
    if scale in NORMALIZED:
        is_inverse = scale == "inverse"
        low, high = stated_range(stored.metadata) or (None, None)
        if is_inverse and low and high:
            low, high = 1 / high, 1 / low
        writing = replace(writing, vmin=low, vmax=high)
        return replace(writing, png_normalize=not is_inverse, png_inverse=is_inverse)
    if stored.is_integer and stored.scale and writing.units_per_metre == options.MILLIMETRES:
        return replace(writing, png_scale=stored.scale.units_per_metre)
    return writing


def _colours(request: ConvertRequest, image: str, depth: types.DepthMap) -> types.Frame:
    limit, size = max(options.MAX_PIXELS, depth.values.size), f"{depth.width}×{depth.height}"
    frame = read_image(image, max_pixels=limit, **request.reading._asdict())
    frame = types.displayed_frame(frame)
    if (image_size := f"{frame.width}×{frame.height}") != size:
        problem = f"{image} has {image_size} pixels and the depth {size}"
        raise InputError(problem, "give the image that the depth was made of")
    return frame


def _with_camera_of(frame: types.Frame | None, depth: types.DepthMap) -> types.DepthMap:
    """Depth whose file states no camera, with that of its image."""
    source = depth.provenance
    is_known = source.focal_px is not None or source.is_cropped or source.projection.is_other
    if frame is None or is_known:
        return depth
    source = replace(source, projection=frame.projection)
    if frame.focal_35mm is not None:
        focal_px = Intrinsics(focal_35mm=frame.focal_35mm).focal_for(frame.width, frame.height)
        source = replace(source, focal_px=focal_px, camera_source=CameraSource.EXIF)
    return replace(depth, provenance=source)


@dataclass(frozen=True, slots=True)
class FolderPlan:
    """The depth files of a folder, and the names of their outputs."""

    inputs: tuple[InputFile, ...]  #: in an order that depends on their names only
    targets: tuple[str, ...]  #: path or URI of the output of each
    skipped: tuple[Skipped, ...]  #: files that hold no depth by their names, or are not wanted
    loops: tuple[str, ...]  #: links to a folder above them, which are not followed


def plan_folder(request: ConvertRequest, names_filter: NameFilter = folders.ANY) -> FolderPlan:
    """List the depth files of a folder that are wanted, and name their outputs.

    ``hall/a.depth.png`` becomes ``hall/a.depth.exr``. Names depend on all files of the folder, not
    on the wanted ones: beside ``a.npy``, they are ``a.depth.png.depth.exr`` and
    ``a.npy.depth.exr``. UsageError if an output would replace an input, or nothing is left.
    """
    if request.format is None:
        raise UsageError("the outputs have no format", "give {format}, for example exr")
    root, out = paths.without_file_scheme(request.source), paths.without_file_scheme(request.target)
    paths.check_writable(paths.path_of(out))
    if os.path.realpath(root) == os.path.realpath(out):  # the next run would read the outputs
        raise UsageError(f"{out} is the folder of the inputs", "choose another {out}")
    listing = folders.list_folder(
        root, leave_out=out, skip=names_filter.excludes, refusal=_why_no_depth
    )
    names = outputs.OutputNames((file.name for file in listing.media), _stem)
    inputs, skipped, where = list[InputFile](), listing.skipped, paths.safe_name(root)
    for file in listing.media:
        refusal = None if file.problem else names_filter.refusal(file.name)
        if refusal is None:
            inputs.append(file)
        else:
            skipped.append(Skipped(file.name, refusal))
    rest = f": {folders.skip_summary(skipped)}" if skipped else ""
    if listing.media and not inputs:
        raise UsageError(f"nothing of {where} is left{rest}", "change {include} or {exclude}")
    if not inputs:
        raise InputError(f"no depth file ({', '.join(table.READABLE_SUFFIXES)}) in {where}{rest}")
    targets = [paths.join(out, _target(names.base(file.name), request.format)) for file in inputs]
    return _checked(FolderPlan(tuple(inputs), tuple(targets), tuple(skipped), tuple(listing.loops)))


def plan_sequence(request: ConvertRequest) -> FolderPlan:
    """List numbered depth files, and name their outputs by a pattern, with the same numbers."""
    _, pattern = target_of(request.target, request.format)
    images = numbering.find_images(paths.path_of(request.source), is_depth=True)
    names = [numbering.numbered_name(pattern.name, image.number) for image in images]
    inputs = tuple(InputFile(image.path.name, str(image.path)) for image in images)
    return _checked(FolderPlan(inputs, tuple(str(pattern.with_name(n)) for n in names), (), ()))


def _checked(plan: FolderPlan) -> FolderPlan:
    """The plan; UsageError if an output would replace an input, or another output."""
    sources = map(paths.path_of, (file.path for file in plan.inputs))
    targets = ({table.Format.EXR: paths.path_of(target)} for target in plan.targets)
    outputs.check_collisions([*map(outputs.OutputPlan, sources, targets)])
    return plan


def convert_folder(
    request: ConvertRequest, plan: FolderPlan, workers: int = 1
) -> Generator[ConvertResult | FailedInput, None, None]:
    """Convert the planned files, in their order; a bad one does not stop the others."""

    def convert_one(pair: tuple[InputFile, str]) -> ConvertResult | FailedInput:
        file, target = pair
        try:
            file.readable_path()  # raises its problem
            return convert(replace(request, source=file.path, target=target))
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            if not isinstance(error, DepthcliError):
                error = InputError(failure_reason(error))
            return FailedInput(paths.safe_name(file.path), error)

    pairs = zip(plan.inputs, plan.targets, strict=True)
    with (
        parallel.one_thread_each(workers),
        closing(parallel.ordered_map(convert_one, pairs, workers=workers)) as results,
    ):
        yield from results


def _why_no_depth(path: str) -> str | None:
    """Why a file in a folder is not an input; None if it may hold depth."""
    name = PurePosixPath(path)
    if name.name.startswith("."):
        return folders.HIDDEN
    if name.suffix.lower() not in table.READABLE_SUFFIXES or re.search(_OTHER_BIN, name.name):
        return name.suffix.lower() or "without suffix"
    kind = table.format_of(name)
    is_image = kind is not None and not kind.facts.is_readable and is_own_image(path)
    return str(kind) if is_image else None


def _stem(name: str) -> str:
    """A name without the suffix of its format: ``hall/a`` of ``hall/a.depth.png``."""
    above, slash, last = name.rpartition("/")
    return above + slash + table.stem_of(last)


def _target(base: str, format_: table.Format) -> str:
    """The name of an output; ``clip.depth.000001`` says already that it is depth."""
    suffix = format_.facts.suffix
    return base + (suffix.removeprefix(".depth") if re.search(_FRAME, base) else suffix)


def convert_video(request: ConvertRequest, workers: int) -> Generator[ConvertResult, None, None]:
    """Convert every frame of a depth video, in their order; the target is a pattern for numbers."""
    _check_sequence(request)
    format_, pattern = target_of(request.target, request.format)

    def frames(video: depth_video.DepthVideo) -> Generator[StoredDepth | InputError, None, None]:
        try:
            yield from video.frames(paths.safe_name(request.source))
        except InputError as error:
            yield error

    def convert_frame(stored: StoredDepth | InputError) -> ConvertResult:
        if isinstance(stored, InputError):  # at its turn, so that all frames before are written
            raise stored
        name = numbering.numbered_name(pattern.name, stored.frame.index)
        return _write_converted(stored, request, format_, pattern.with_name(name))

    with paths.local_copy(paths.path_of(request.source)) as path, parallel.one_thread_each(workers):
        maps = frames(inspect.open_depth_video(path, request.stated))
        with closing(parallel.ordered_map(convert_frame, maps, workers=workers)) as results:
            yield from results


def convert_to_video(
    request: ConvertRequest, format_: formats.VideoFormat, warnings: list[str]
) -> Generator[ConvertResult, None, None]:
    """Convert every frame of a depth video, or of numbered depth files, to one video.

    Warnings about all frames are added to a list.
    """
    _check_sequence(request)
    source, path = paths.path_of(request.source), paths.path_of(request.target)
    with ExitStack() as stack:
        if inspect.is_depth_video(source):
            copy = stack.enter_context(paths.local_copy(source))
            video, inputs = inspect.open_depth_video(copy, request.stated), [source]
            frames, rate = video.frames(paths.safe_name(request.source)), video.rate
        else:
            images = numbering.find_images(source, is_depth=True)
            inputs = [image.path for image in images]
            rate = request.fps or stated_rate(inputs) or _rate_of_times(images)
            frames = _numbered_maps(images, rate or FALLBACK_RATE, request)
        if rate is None:
            assumed = f"no frame rate is given; {FALLBACK_RATE} is assumed"
            warnings.append(Message(assumed, "give {fps}"))
        timing = Timing(rate or FALLBACK_RATE, source_rate=rate, step=None)
        Guard.of(inputs, overwrite=request.overwrite).check(path)
        output = stack.enter_context(video_file(format_, path, timing, request.writing))
        decay = temporal.ema_decay(float(1 / timing.rate), LOCK_S)
        shape, lock = None, temporal.RangeLock()
        for stored in frames:
            depth = types.with_camera(stored.displayed, request.camera)
            if shape not in {None, depth.values.shape}:  # which FFmpeg would resize
                raise InputError(f"{stored.name} has another size than the first frame")
            shape, spread = depth.values.shape, lock.step(*preview.percentiles(depth), decay)
            output.append(output.encode(DepthFrame(stored.frame, depth, spread)))
            doubts = stored.warnings_with_scale("from_scale")
            yield ConvertResult(paths.safe_name(stored.name), str(path), depth, None, doubts)
        warnings += output.finish()


def _rate_of_times(images: Sequence[numbering.NumberedImage]) -> Fraction | None:
    """The frame rate by the times that the first and the last of numbered files state."""
    first, last = images[0], images[-1]
    try:
        ends = [float(read_metadata(path)["time_s"]) for _, path in (first, last)]
        return exact_rate((last.number - first.number) / (ends[1] - ends[0]))
    except (InputError, KeyError, ZeroDivisionError):  # reading its pixels reports errors
        return None


def _numbered_maps(
    images: Sequence[numbering.NumberedImage], rate: Fraction, request: ConvertRequest
) -> Iterator[StoredDepth]:
    """The maps of numbered files, with their numbers, and times as stated, else by the rate."""
    if numbering.are_times(images):
        images = [image._replace(number=count) for count, image in enumerate(images)]
    last_s = -math.inf
    for number, path in images:
        stored = inspect.read_map(path, request.stated)
        stated_s = None if request.fps else stored.depth.provenance.time_s
        time_s = float((number - images[0].number) / rate) if stated_s is None else stated_s
        if time_s <= last_s:
            raise InputError(f"{path} is not later than the frame before it", "give {fps}")
        last_s = time_s
        yield replace(stored, frame=replace(stored.frame, index=number, timestamp_s=time_s))


def _check_sequence(request: ConvertRequest) -> None:
    name, source = paths.safe_name(request.target), paths.path_of(request.source)
    if not (inspect.is_depth_video(source) or numbering.is_sequence(source)):
        raise UsageError(
            f"{name} is for all frames, but {paths.safe_name(request.source)} is neither a depth "
            "video (.mkv) nor a sequence such as depth.%04d.exr",
            "name one file, or a folder with {out}",
        )
    if request.stated.frame is not None or request.image is not None:
        option = "image" if request.stated.frame is None else "frame"
        raise UsageError(f"it is for one map, but {name} is all frames", "remove it", option=option)
