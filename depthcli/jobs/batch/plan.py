"""Planning a batch of a folder or a list."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from depthcli.core.camera import Intrinsics
from depthcli.core.options import short_repr
from depthcli.errors import InputError, UsageError
from depthcli.io.formats.table import Format
from depthcli.io.guard import is_own_output
from depthcli.io.listing import folder as listing
from depthcli.io.listing.path_list import listed_inputs
from depthcli.io.manifest import WHOLE, Shard
from depthcli.io.media import ARCHIVE_SUFFIXES, is_archive, is_video
from depthcli.io.storage import paths
from depthcli.io.tables import read_lenses
from depthcli.jobs.outputs import OutputNames, sharing_stem, stem
from depthcli.video.formats import VideoFormat


@dataclass(frozen=True, slots=True)
class BatchPlan:
    """All inputs of a batch."""

    out: Path  #: the output folder
    inputs: tuple[listing.InputFile, ...]  #: in an order that depends on their names only
    names: OutputNames  #: the names of all shards' inputs, and those of their outputs
    skipped: tuple[listing.Skipped, ...]  #: files that are no inputs
    loops: tuple[str, ...] = ()  #: links to a folder above them
    like_outputs: frozenset[str] = frozenset()  #: real paths of inputs with a name of an output
    shard: Shard = WHOLE  #: the part of the inputs that is planned
    #: cameras of a table, by input; the others are not in it
    intrinsics: Mapping[str, Intrinsics] = field(default_factory=dict)
    same_stem: frozenset[str] = frozenset()  #: images whose stem is that of another image
    is_part: bool = False  #: whether other files of the folder may be inputs of other batches
    camera_warnings: tuple[str, ...] = ()  #: what in that table matches no input, and vice versa

    @property
    def warnings(self) -> Iterator[str]:
        """Warnings before the start, one line each."""
        yield from self.camera_warnings
        if unreadable := listing.conversion_hint(self.skipped):
            yield unreadable

    @property
    def images(self) -> Iterator[listing.InputFile]:
        """The images: all inputs but videos and archives."""
        return (file for file in self.inputs if not holds_many(file.name))

    @property
    def videos(self) -> Iterator[listing.InputFile]:
        """The videos, and the archives of images."""
        return (file for file in self.inputs if holds_many(file.name))

    def folders(self) -> set[Path]:
        """The folders of the outputs."""
        return {self.out, *((self.out / file.name).parent for file in self.inputs)}


def holds_many(name: str) -> bool:
    """Whether a name is a video's, or that of an archive of images."""
    return is_video(name) or is_archive(name)


class CameraTable:
    """Finds the camera of each input, and notes which rows match.

    A row's id is the name of an input (``hall/a.jpg``), or the name without suffix (``hall/a``).
    """

    def __init__(self, cameras: Mapping[str, Intrinsics], source: str = "the table") -> None:
        self._cameras, self._source = cameras, source
        self._unused = dict.fromkeys(cameras)

    def camera_of(self, name: str) -> Intrinsics | None:
        """The camera of an input; None if it has no row, or an empty one."""
        row_id = name if name in self._cameras else stem(name)
        self._unused.pop(row_id, None)
        return self._cameras.get(row_id)

    def warnings(self, inputs: int, unmatched: int) -> Iterator[str]:
        """Patterns that did not match; UsageError if no row matches. ``unmatched`` have no row."""
        unused = list(self._unused)
        if unused and inputs and len(unused) == len(self._cameras):
            raise UsageError(
                f"no row of {self._source} with a camera matches an input; an id is the path of an "
                "input from the folder, with or without its suffix, but the first is "
                f"{short_repr(unused[0])}"
            )
        if unmatched:
            yield (
                f"{self._source} has no camera for {unmatched} of {inputs} inputs; their focal "
                "lengths are those in EXIF, or assumed"
            )
        if unused:
            rows = f"{len(unused)} of {len(self._cameras)} rows of {self._source}"
            yield f"{rows} match no input, for example {short_repr(unused[0])}"


def read_cameras(source: str) -> CameraTable:
    """The table in a CSV file or URI; UsageError if it cannot be read, or has invalid rows."""
    try:
        return CameraTable(read_lenses(paths.path_of(source)), os.fspath(source))
    except InputError as error:
        raise UsageError(str(error), option="cameras") from error


_OUTPUT_SUFFIXES = (
    *(format_.facts.suffix for format_ in (*Format, *VideoFormat)),
    *(f".depth{suffix}" for suffix in ARCHIVE_SUFFIXES),
)


@dataclass(frozen=True, slots=True)
class InputCollector:
    """Collects the inputs of a shard and the files that are skipped."""

    out: str  #: the output folder
    names_filter: listing.NameFilter  #: which files are inputs
    shard: Shard  #: the part of them that is planned
    cameras: CameraTable | None  #: of each input
    _inputs: dict[str, listing.InputFile] = field(default_factory=dict)
    _skipped: dict[listing.Skipped, None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        paths.check_writable(paths.path_of(self.out))

    def skip(self, file: listing.Skipped) -> None:
        """Add a skipped file."""
        if self.shard.holds(file.name):
            self._skipped[file] = None

    def plan(
        self,
        media: Iterable[listing.InputFile],
        where: str,
        loops: tuple[str, ...] = (),
        *,
        is_list: bool = False,
    ) -> BatchPlan:
        """Make a plan of images and videos; the order of a list does not count."""
        places, cameras = listing.RealPaths(), self.cameras
        all_names, like_outputs, intrinsics = set[str](), set[str](), dict[str, Intrinsics]()
        for file in media:
            reason = None if file.problem else self.names_filter.refusal(file.name)
            if reason is not None:
                self.skip(listing.Skipped(file.name, reason))
                continue
            all_names.add(file.name)
            like_outputs.update(p for p in places.all_of(file.path) if p.endswith(_OUTPUT_SUFFIXES))
            camera = cameras.camera_of(file.name) if cameras else None
            if self.shard.holds(file.name):
                self._add(file, places)
                intrinsics |= {file.name: camera} if camera is not None else {}
        if not all_names:
            _check_any([*self._skipped], where)
        names, count = OutputNames(all_names), len(self._inputs)
        unmatched = count - len(intrinsics)
        return BatchPlan(
            out=paths.path_of(self.out),
            inputs=tuple(sorted(self._inputs.values()) if is_list else self._inputs.values()),
            names=names,
            skipped=tuple(self._skipped),
            loops=loops,
            like_outputs=frozenset(like_outputs),
            shard=self.shard,
            intrinsics=intrinsics,
            same_stem=sharing_stem(name for name in names.longer if not is_video(name)),
            is_part=is_list or bool(self.names_filter.include or self.names_filter.exclude),
            camera_warnings=tuple(cameras.warnings(count, unmatched)) if cameras else (),
        )

    def _add(self, file: listing.InputFile, places: listing.RealPaths) -> None:
        first = self._inputs.setdefault(file.name, file)
        if first is file:
            return
        if places.of(first.path) != places.of(file.path):  # outside the list's folder
            problem = f"{first.path} and {file.path} would both become {file.name}"
            raise UsageError(problem, "list them for batches with different {out}")
        self.skip(listing.Skipped(file.name, listing.TWICE))


def _check_any(skipped: Sequence[listing.Skipped], where: str) -> None:
    reasons, summary = {file.reason for file in skipped}, listing.skip_summary(skipped)
    if not skipped:
        return
    if {listing.NOT_INCLUDED, listing.EXCLUDED} & reasons:
        raise UsageError(f"nothing of {where} is left: {summary}", "change {include} or {exclude}")
    hint = listing.conversion_hint(skipped) or ""
    if not hint and ".exr" in reasons:
        hint = "EXR is read by 'predict', by 'video' (a sequence), and by 'batch' from a list"
    raise InputError(f"no image or video in {where}: {summary}", hint)


def plan_folder(
    root: str | os.PathLike[str],
    out: str | os.PathLike[str],
    names_filter: listing.NameFilter = listing.ANY,
    shard: Shard = WHOLE,
    cameras: CameraTable | None = None,
) -> BatchPlan:
    """Plan all images and videos in a folder tree, or its archives if it holds no other.

    UsageError if there is no such folder, outputs would become inputs, or the patterns exclude
    everything; InputError if no file can be read.
    """
    root, out = paths.without_file_scheme(root), paths.without_file_scheme(out)
    place = paths.path_of(root)
    # A store is checked when it is listed.
    is_store = isinstance(place, paths.RemotePath) and not place.is_http
    if not is_store and not place.is_dir():
        is_file = not isinstance(place, paths.RemotePath) and place.is_file()
        hint = "; 'depthcli predict' and 'depthcli video' take files" if is_file else ""
        raise UsageError(f"{place} is not a folder", f"name one, or give {{files}} a list{hint}")
    if os.path.realpath(root) == os.path.realpath(out):  # the next run would read the outputs
        advice = "choose another folder, for example one inside it"
        raise UsageError(f"{out} is the folder of the inputs", advice, option="out")
    collector = InputCollector(out, names_filter, shard, cameras)
    tree = listing.list_folder(root, leave_out=out, skip=names_filter.excludes)
    media = list(tree.media)
    if media and media[0].name == ".":
        raise UsageError(f"{media[0].problem}")
    for file in tree.skipped:
        is_archive = file.reason in ARCHIVE_SUFFIXES
        if tree.media or not is_archive or is_own_output(file.name):
            collector.skip(file)
        else:  # a data set in archives alone
            media.append(listing.InputFile(file.name, paths.join(root, file.name)))
    return collector.plan(media, paths.safe_name(root), loops=tuple(tree.loops))


def plan_files(
    words: Iterable[str],
    source: str,
    root: str | os.PathLike[str] | None,
    out: str | os.PathLike[str],
    names_filter: listing.NameFilter = listing.ANY,
    shard: Shard = WHOLE,
    cameras: CameraTable | None = None,
) -> BatchPlan:
    """Plan the files of a list, with any suffix; ``source`` is the name of the list in messages.

    Relative paths start from ``root``, whose tree is kept; None for the working directory, while
    absolute paths keep all their folders. Of the files of other shards, only names are kept.
    """
    root = None if root is None else paths.without_file_scheme(root)
    collector = InputCollector(paths.without_file_scheme(out), names_filter, shard, cameras)

    def images() -> Iterator[listing.InputFile]:
        for file in listed_inputs(words, root):
            if file.problem is None and is_own_output(file.path):
                collector.skip(listing.Skipped(file.name, listing.OWN))
            else:
                yield file

    return collector.plan(images(), f"the list {paths.safe_name(source)}", is_list=True)
