"""What commands on images share: options of maps, ``-o/--out``, and the names of outputs."""

from __future__ import annotations

import hashlib
import os
import unicodedata
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Generic, NamedTuple, Self, TypeVar

from depthcli.core import options
from depthcli.core.camera import UNKNOWN_CAMERA, Anchor, Intrinsics
from depthcli.errors import UsageError
from depthcli.io.formats.table import Format, WriterOptions, suffix_of
from depthcli.io.listing import RealPaths
from depthcli.io.storage import atomic, paths
from depthcli.video.numbering import base_name, is_pattern

if TYPE_CHECKING:
    from depthcli.core.types import Frame
    from depthcli.known.files import KnownDepthFiles
    from depthcli.known.points import KnownDepth
    from depthcli.video.formats import VideoFormat

STDIO = "-"
_STDIN_STEM = "stdin"
FormatT = TypeVar("FormatT", Format, "VideoFormat")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapOptions:
    """How images are read, predicted and written."""

    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the formats
    camera: Intrinsics = UNKNOWN_CAMERA  #: what is known of the camera
    anchors: KnownDepthFiles | tuple[Anchor, ...] = ()  #: known depth, or where files have it
    #: how depth is fitted to that; None for the best that the model can
    anchors_fit: options.DepthFit | None = None
    reading: options.ReadOptions = options.AS_STATED  #: how images are read
    #: how depth becomes that of a full-size image
    detail: options.UpsamplingOptions = options.DEFAULT_UPSAMPLING
    max_pixels: int = options.MAX_PIXELS  #: larger images are refused

    @property
    def takes_known_depth(self) -> bool:
        """Whether a network may get known depth."""
        return bool(self.anchors) and self.anchors_fit in {None, options.DepthFit.NETWORK}

    def known_points(self, image: Path | None = None) -> KnownDepth | None:
        """The known depth of an image that is listed, in one file for all, or found by its name.

        None if there is none for any; InputError if it cannot be read.
        """
        if not self.anchors:
            return None
        from depthcli.known.sources import read_known_depth  # noqa: PLC0415 - needs numpy

        return replace(read_known_depth(self.anchors, image), fit=self.anchors_fit)

    def read(self, path: Path | None, data: bytes | None, name: str = "standard input") -> Frame:
        """An image; arguments and errors as of :func:`depthcli.io.images.read.read_image`."""
        from depthcli.io.images.read import read_image, undistorted  # noqa: PLC0415 - needs numpy

        limit, options = self.max_pixels, self.reading._asdict()
        frame = read_image(path, data, max_pixels=limit, name=name, **options)
        return undistorted(frame, self.camera)


class Kind(StrEnum):
    """Kinds of destinations that ``-o/--out`` names."""

    BESIDE = "beside"  #: nothing: outputs stand beside their inputs
    FOLDER = "folder"
    FILE = "file"  #: one file, or the stem of several
    PATTERN = "pattern"  #: numbered files, such as ``depth.%04d.exr``
    STDOUT = "stdout"


@dataclass(frozen=True, slots=True)
class FormatRules(Generic[FormatT]):
    """Rules by which a command chooses the formats of its outputs."""

    defaults: tuple[FormatT, ...]  #: in a folder, and beside the inputs
    of_name: Callable[[str], FormatT | None]  #: the format that the name of a file chooses
    stem_of: Callable[[str], str]  #: a file's name without the suffix of its format
    suffixes: tuple[str, ...]  #: of files that choose a format, for messages
    stdout: FormatT | None = None  #: for standard output; None if nothing is written there
    #: the format that the name of numbered files chooses; None if the command writes none
    of_pattern: Callable[[str], FormatT | None] | None = None
    is_bare_folder: bool = False  #: whether a name without suffix is that of a folder


@dataclass(frozen=True, slots=True)
class Destination(Generic[FormatT]):
    """Where outputs are written, and their formats."""

    kind: Kind
    path: Path | None  #: file, folder or pattern; None beside the inputs, and for standard output
    formats: tuple[FormatT, ...]  #: each once
    sidecar: FormatT | None = None  #: JSON besides, if it is not one of the formats
    stem: str | None = None  #: of several files at the path; None for one's whole name, or a folder

    @classmethod
    def parse(
        cls,
        out: str | None,
        requested: Sequence[FormatT],
        rules: FormatRules[FormatT],
        sidecar: FormatT | None = None,
    ) -> Self:
        """Parse ``-o/--out``: a file or URI, a folder, a pattern, ``-``, or None for beside inputs.

        A folder exists, or ends in ``/``. If no formats are asked for, the suffix chooses, or the
        command's rules; ``sidecar`` is written besides.
        """
        kind = _kind_of(out, is_bare_folder=rules.is_bare_folder)
        path = None if out is None or kind is Kind.STDOUT else paths.path_of(out)
        if path is not None:
            paths.check_writable(path)
        formats = _formats(kind, path, tuple(dict.fromkeys(requested)), rules)
        stem = None
        if path is not None and kind is Kind.FILE:
            if atomic.is_special(path):
                raise _out_error(path, "is a device or a pipe", "'-' is standard output")
            if len(formats) > 1 or "%" in formats[0].facts.suffix:
                stem = rules.stem_of(path.name)
            elif rules.of_name(path.name) is None:
                path = path.with_name(path.name + formats[0].facts.suffix)
        return cls(kind, path, formats, None if sidecar in formats else sidecar, stem)

    @property
    def wanted(self) -> tuple[FormatT, ...]:
        """The formats, and the sidecar's."""
        return self.formats + (() if self.sidecar is None else (self.sidecar,))

    def outputs(self, base: Path) -> dict[FormatT, Path]:
        """Path of each output of an input, whose base, without suffix, counts without a name."""
        path = self.path
        if path is None or self.kind is Kind.FOLDER or self.stem is not None:
            base = path.with_name(self.stem) if path and self.stem is not None else base
            return {kind: base.with_name(base.name + kind.facts.suffix) for kind in self.wanted}
        stem = base_name(path.stem) if self.kind is Kind.PATTERN else path.stem
        rest = path.stem.removeprefix(stem)  # such as .%04d
        ends = {kind: kind.facts.suffix.replace(".%06d", rest) for kind in self.formats[1:]}
        named = {kind: path.with_name(stem + end) for kind, end in ends.items()}
        beside = {} if self.sidecar is None else {self.sidecar: path.with_name(f"{stem}.json")}
        return {self.formats[0]: path, **named, **beside}


def _kind_of(out: str | None, *, is_bare_folder: bool) -> Kind:
    if out is None:
        return Kind.BESIDE
    if not out:
        raise UsageError("is empty", "name a file or a folder, or omit it", option="out")
    if out.endswith(("/", os.sep)) or paths.path_of(out).is_dir():
        return Kind.FOLDER
    if out == STDIO:
        return Kind.STDOUT
    if is_pattern(paths.path_of(out).name):
        return Kind.PATTERN
    return Kind.FOLDER if is_bare_folder and not paths.path_of(out).suffix else Kind.FILE


def _formats(
    kind: Kind, path: Path | None, requested: tuple[FormatT, ...], rules: FormatRules[FormatT]
) -> tuple[FormatT, ...]:
    """The formats to write: the requested ones, else those of the destination."""
    if path is not None and kind is Kind.PATTERN:
        return _formats_of_pattern(path, requested, rules)
    if kind in {Kind.BESIDE, Kind.FOLDER}:
        return requested or rules.defaults
    named_format = rules.stdout if path is None else rules.of_name(path.name)
    chosen = requested or ((named_format,) if named_format else ())
    if not chosen:
        suffix, suffixes = path.suffix if path else "", ", ".join(rules.suffixes)
        raise _out_error(
            path or Path(STDIO),
            f"ends in {suffix}, which is no format" if suffix else "has no suffix of a format",
            f"use {suffixes}, give {{format}}, or end the name in '/' for a folder",
        )
    if path is not None and named_format is not None and len(chosen) == 1:
        _check_suffix(path, chosen[0])
    return chosen


def _formats_of_pattern(
    path: Path, chosen: tuple[FormatT, ...], rules: FormatRules[FormatT]
) -> tuple[FormatT, ...]:
    """The format of the numbered files, and the others, which get the name before the number."""
    if rules.of_pattern is None:
        what = "is a pattern for numbered files of a video"
        raise _out_error(path, what, "name one file, or a folder")
    numbered = [kind for kind in chosen if "%" in kind.facts.suffix]  # two may have one suffix
    fitting = [kind for kind in numbered if Path(kind.facts.suffix).suffix == suffix_of(path)]
    named_format: FormatT | None = fitting[0] if fitting else rules.of_pattern(path.name)
    if named_format is None or (chosen and named_format not in chosen):
        what = "is a pattern for numbered files, which end in .png, .exr or .npy"
        raise _out_error(path, what, "give such a name, and its {format} with any other")
    formats: list[FormatT] = [named_format]
    formats += [kind for kind in chosen if kind != named_format]
    return tuple(formats)


def _check_suffix(path: Path, format_: FormatT) -> None:
    suffix = Path(f"a{format_.facts.suffix}").suffix
    if "%" in format_.facts.suffix:
        advice = f"name a folder, or a pattern such as {path.stem}.%04d{suffix}"
        raise _out_error(path, f"is one file, and {format_} writes one per frame", advice)
    if suffix_of(path) != suffix:
        raise _out_error(path, f"does not end in {suffix}", "the suffix has to match {format}")


def _out_error(path: Path, problem: str, advice: str) -> UsageError:
    return UsageError(f"{paths.safe_name(str(path))} {problem}", advice, option="out")


class OutputPlan(NamedTuple, Generic[FormatT]):
    """The outputs of one input."""

    source: Path | None  #: the input; None for standard input
    outputs: dict[FormatT, Path]  #: path of each format
    name: str = ""  #: the input as the user wrote it


def plan_outputs(
    sources: Sequence[Path | None], destination: Destination[FormatT]
) -> list[OutputPlan[FormatT]]:
    """Name every output that goes to a file; None is standard input.

    Without a destination, outputs are placed beside their input. If two inputs in one folder differ
    only in their suffix, the names of their outputs keep it (``a.jpg.depth.png``,
    ``a.png.depth.png``). A folder without a name, such as ``.`` or ``/``, gets no outputs.
    """
    if destination.kind not in {Kind.BESIDE, Kind.FOLDER} and len(sources) != 1:
        path = destination.path or Path(STDIO)
        problem = f"is one file but there are {len(sources)} inputs"
        raise _out_error(path, problem, f"name a folder: {path}/")
    plans = []
    for source, base in zip(sources, output_bases(sources), strict=True):
        folder = destination.path or (Path() if source is None else source.parent)
        is_nameless = source is not None and not source.name
        plans.append(OutputPlan(source, {} if is_nameless else destination.outputs(folder / base)))
    check_collisions(plans)
    return plans


def check_collisions(plans: Sequence[OutputPlan[FormatT]]) -> None:
    """Check that no output is an input, or another output; UsageError if one is."""
    places = RealPaths()
    sources = (plan.source for plan in plans if plan.source is not None)
    inputs = {_case_folded_path(place) for source in sources for place in places.all_of(source)}
    owners: dict[str, Path | None] = {}
    for plan in plans:
        for path in plan.outputs.values():
            paths.check_writable(path)
            place = _case_folded_path(places.of(path))
            if place in inputs:
                raise UsageError(f"{path} is an input", "choose another {out}")
            if place in owners:
                raise UsageError(
                    f"{plan.source} and {owners[place]} would both become {path}",
                    "run them one by one with different {out}",
                )
            owners[place] = plan.source


def _case_folded_path(path: str | Path) -> str:
    """The path in the form that case-insensitive file systems compare."""
    return os.path.normcase(os.path.abspath(path)).casefold()  # noqa: PTH100 - links stay as named


def stem(name: str) -> str:
    """A name without its suffix."""
    return os.path.splitext(name)[0]  # noqa: PTH122 - a name with "/" on any system


def sharing_stem(names: Iterable[str], stem: Callable[[str], str] = stem) -> frozenset[str]:
    """Those of some names whose stem is the stem of another, or another name."""
    names = frozenset(names)
    takers = Counter(key for name in names for key in {_folded(name), _folded(stem(name))})
    return frozenset(name for name in names if takers[_folded(stem(name))] > 1)


def _folded(name: str) -> str:
    """The form in which case- or Unicode-insensitive file systems compare a name."""
    return unicodedata.normalize("NFC", name).casefold()


class OutputNames:
    """The names of the outputs of some inputs, without suffix.

    That is the input's name without suffix (``a`` for ``a.jpg``). If another of the inputs has the
    same, it is the full name (``a.jpg``); if names differ only in ways that some file systems
    ignore (``A.jpg``, ``a.jpg``), the full name and a checksum of it.

    Attributes:
        names: the inputs, paths from the root with ``/``.
        longer: the names of outputs that are not the input's name without suffix.
    """

    def __init__(self, names: Iterable[str] = (), stem: Callable[[str], str] = stem) -> None:
        """Name the outputs; ``stem`` removes suffixes."""
        self.names, self._stem = frozenset(names), stem
        shared = sharing_stem(self.names, stem)
        alike = Counter(map(_folded, shared))
        self.longer = {name: name for name in shared}
        for name in (name for name in shared if alike[_folded(name)] > 1):
            self.longer[name] += f".{hashlib.sha256(os.fsencode(name)).hexdigest()[:8]}"

    def base(self, name: str) -> str:
        """Path of an input's outputs from the output folder, without a suffix."""
        return self.longer.get(name) or self._stem(name)


def output_bases(sources: Sequence[Path | None]) -> list[str]:
    """The names of each input's outputs, without suffix; None is standard input."""
    inside = defaultdict[Path, list[str]](list)
    for source in filter(None, sources):
        inside[source.parent].append(source.name)
    folders = {folder: OutputNames(names) for folder, names in inside.items()}
    return [_STDIN_STEM if s is None else folders[s.parent].base(s.name) for s in sources]
