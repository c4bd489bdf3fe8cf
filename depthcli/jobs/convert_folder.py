"""Converting all depth files of a folder tree."""

import os
import re
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import PurePosixPath

from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.parallel.opencv_threads import one_thread_each
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.errors import DepthcliError, InputError, UsageError
from depthcli.io.formats.table import Format, WriterOptions, format_of, stem_of
from depthcli.io.images.native_log import silent_opencv
from depthcli.io.listing.folder import InputFile, list_folder
from depthcli.io.listing.globs import ANY, NameFilter
from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.io.listing.skipped import HIDDEN, Skipped, skip_summary
from depthcli.io.listing.store import list_objects, walk_sort_key
from depthcli.io.storage.remote import (
    RemotePath,
    check_writable,
    join,
    path_of,
    safe_name,
    without_file_scheme,
)
from depthcli.jobs.convert import ConvertRequest, ConvertResult, convert
from depthcli.jobs.failed import FailedInput, failure_reason
from depthcli.jobs.naming import OutputPlan, check_collisions
from depthcli.jobs.tree_names import TreeNames

_SUFFIXES = (".png", ".exr", ".npy")
_FRAME = r"(?i)\.depth\.\d{6,}$"
"""End of the stem of a numbered file, ``clip.depth.000001``."""


@dataclass(frozen=True, slots=True)
class ConvertFolderRequest:
    """A folder of depth files, and how to convert them."""

    root: str  #: the folder, searched recursively
    out: str  #: receives the outputs, with the same folder structure
    format: Format  #: of the outputs
    wanted: NameFilter = ANY  #: the files to convert
    scale: float | None = None  #: units per metre of the inputs; None for what each states
    #: instead of that of each input; depth is not changed
    camera: Intrinsics = UNKNOWN_CAMERA
    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the format
    overwrite: bool = False  #: whether outputs may replace files of other programs
    workers: int = 1  #: files converted in parallel


@dataclass(frozen=True, slots=True)
class FolderPlan:
    """The depth files of a folder, and the names of their outputs."""

    inputs: tuple[InputFile, ...]  #: in an order that depends on their names only
    targets: tuple[str, ...]  #: path or URI of the output of each
    skipped: tuple[Skipped, ...]  #: files that hold no depth by their names, or are not wanted
    loops: tuple[str, ...]  #: links to a folder above them, which are not followed


def plan_conversion(request: ConvertFolderRequest) -> FolderPlan:
    """List the depth files of a folder, and name their outputs.

    ``hall/a.depth.png`` becomes ``hall/a.depth.exr``. Names depend on all files of the folder, not
    on the wanted ones: beside ``a.npy``, they are ``a.depth.png.depth.exr`` and
    ``a.npy.depth.exr``.

    Raises:
        UsageError: the output folder is that of the inputs, an output would replace an input, or
            the patterns exclude everything.
        InputError: there is no depth file.
    """
    root, out = without_file_scheme(request.root), without_file_scheme(request.out)
    check_writable(path_of(out))
    if os.path.realpath(root) == os.path.realpath(out):  # the next run would read the outputs
        raise UsageError(f"--out {out} is the folder of the inputs; choose another folder")
    found, skipped, loops = _listed(root, out, request.wanted)
    names = TreeNames((file.name for file in found), _stem)
    inputs = []
    for file in found:
        refusal = None if file.problem else request.wanted.refusal(file.name)
        if refusal is None:
            inputs.append(file)
        else:
            skipped.append(Skipped(file.name, refusal))
    if not inputs:
        rest = f": {skip_summary(skipped)}" if skipped else ""
        if found:
            raise UsageError(f"--include and --exclude leave nothing of {safe_name(root)}{rest}")
        raise InputError(f"no depth file (.png, .exr, .npy) in {safe_name(root)}{rest}")
    targets = [join(out, _target(names.base(file.name), request.format)) for file in inputs]
    check_collisions(
        [
            OutputPlan(path_of(file.path), {request.format: path_of(target)})
            for file, target in zip(inputs, targets, strict=True)
        ]
    )
    return FolderPlan(tuple(inputs), tuple(targets), tuple(skipped), loops)


def convert_folder(
    request: ConvertFolderRequest, plan: FolderPlan
) -> Generator[ConvertResult | FailedInput, None, None]:
    """Convert the planned files, in their order; a bad one does not stop the others.

    Existing outputs are replaced if depthcli wrote them, or if the request says so.
    """

    def convert_one(pair: tuple[InputFile, str]) -> ConvertResult | FailedInput:
        return _convert_one(request, *pair)

    pairs = zip(plan.inputs, plan.targets, strict=True)
    with (
        silent_opencv(),
        one_thread_each(request.workers),
        closing(ordered_map(convert_one, pairs, workers=request.workers)) as results,
    ):
        yield from results


def _listed(
    root: str, out: str, wanted: NameFilter
) -> tuple[tuple[InputFile, ...], list[Skipped], tuple[str, ...]]:
    """The depth files by their names, the other files, and loops."""
    place = path_of(root)
    if not isinstance(place, RemotePath):
        listing = list_folder(root, leave_out=out, skip=wanted.excludes, refusal=_why_no_depth)
        return listing.media, list(listing.skipped), listing.loops
    skipped: list[Skipped] = []
    objects = list_objects(place, path_of(out), wanted.excludes, skipped.append, _why_no_depth)
    # In the order of a local folder, not in that of the store.
    return tuple(sorted(objects, key=lambda file: walk_sort_key(file.name))), skipped, ()


def _why_no_depth(path: str) -> str | None:
    """Why a file in a folder is not an input; None if it may hold depth."""
    name = PurePosixPath(path)
    if name.name.startswith("."):
        return HIDDEN
    if name.suffix.lower() not in _SUFFIXES:
        return name.suffix.lower() or "without suffix"
    is_preview = format_of(name) is Format.PREVIEW and is_own_picture(path)
    return "preview" if is_preview else None


def _stem(name: str) -> str:
    """A name without the suffix of its format: ``hall/a`` of ``hall/a.depth.png``."""
    above, slash, last = name.rpartition("/")
    return above + slash + stem_of(last)


def _target(base: str, wanted: Format) -> str:
    """The name of an output; ``clip.depth.000001`` says already that it is depth."""
    suffix = wanted.facts.suffix
    return base + (suffix.removeprefix(".depth") if re.search(_FRAME, base) else suffix)


def _convert_one(
    request: ConvertFolderRequest, file: InputFile, target: str
) -> ConvertResult | FailedInput:
    if file.problem is not None:
        return FailedInput(safe_name(file.path), InputError(file.problem))
    try:
        return convert(
            ConvertRequest(
                source=file.path,
                target=target,
                format=request.format,
                scale=request.scale,
                camera=request.camera,
                writing=request.writing,
                overwrite=request.overwrite,
            )
        )
    except DepthcliError as error:
        return FailedInput(safe_name(file.path), error)
    except Exception as error:  # noqa: BLE001 - no file may stop the others
        return FailedInput(safe_name(file.path), InputError(failure_reason(error)))
