"""Planning a batch of a folder or a list."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

from depthcli.core.camera import Intrinsics
from depthcli.core.options import short_repr
from depthcli.errors import InputError, UsageError
from depthcli.io.listing import folder as listing
from depthcli.io.listing.path_list import listed_inputs
from depthcli.io.manifest import WHOLE, Shard
from depthcli.io.storage import paths
from depthcli.io.tables import read_lenses
from depthcli.jobs.output_names import TreeNames, namesakes, stem


@dataclass(frozen=True, slots=True)
class BatchPlan:
    """All inputs of a batch."""

    out: Path  #: the output folder
    inputs: tuple[listing.InputFile, ...]  #: in an order that depends on their names only
    names: TreeNames  #: names of their outputs
    skipped: tuple[listing.Skipped, ...]  #: files that are no inputs
    loops: tuple[str, ...] = ()  #: links to a folder above them
    inputs_in_out: frozenset[str] = frozenset()  #: paths of all shards' inputs in ``out``
    shard: Shard = WHOLE  #: the part of the inputs that is planned
    #: cameras of a table, by input; the others are not in it
    intrinsics: Mapping[str, Intrinsics] = field(default_factory=dict)
    stems: TreeNames = field(default_factory=TreeNames)  #: of the pictures of all shards
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
        return (found for found in self.inputs if not holds_many(found.name))

    @property
    def videos(self) -> Iterator[listing.InputFile]:
        """The videos, and the archives of images."""
        return (found for found in self.inputs if holds_many(found.name))

    def folders(self) -> set[Path]:
        """The folders of the outputs."""
        return {self.out, *((self.out / found.name).parent for found in self.inputs)}


def holds_many(name: str) -> bool:
    """Whether a name is a video's, or that of an archive of images."""
    return listing.is_video(name) or listing.is_archive(name)


class CameraTable:
    """Finds the camera of each input, and notes which rows match.

    A row's id is the name of an input (``hall/a.jpg``), or the name without suffix (``hall/a``).
    """

    def __init__(self, cameras: Mapping[str, Intrinsics], source: str = "the table") -> None:
        self._cameras, self._source = cameras, source
        self._unused = dict.fromkeys(cameras)

    def camera_of(self, name: str) -> Intrinsics | None:
        """The camera of an input; None if it has no row, or an empty one."""
        row_id = next((key for key in (name, stem(name)) if key in self._cameras), None)
        if row_id is None:
            return None
        self._unused.pop(row_id, None)
        return self._cameras[row_id]

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


class InputCollector:
    """Collects the inputs of a shard and the files that are skipped."""

    def __init__(
        self, out: str, wanted: listing.NameFilter, shard: Shard, cameras: CameraTable | None
    ) -> None:
        paths.check_writable(paths.path_of(out))
        self._out, self._wanted, self._shard, self._cameras = out, wanted, shard, cameras
        self._intrinsics: dict[str, Intrinsics] = {}
        self._inputs: dict[str, listing.InputFile] = {}
        self._skipped: dict[listing.Skipped, None] = {}
        self._inputs_in_out: set[str] = set()
        self._stems = TreeNames()
        self._has_inputs = False

    def skip(self, file: listing.Skipped) -> None:
        """Add a skipped file."""
        if self._shard.holds(file.name):
            self._skipped[file] = None

    def plan(
        self,
        media: Iterable[listing.InputFile],
        where: str,
        loops: tuple[str, ...] = (),
        *,
        is_list: bool = False,
    ) -> BatchPlan:
        """Make a plan of images and videos."""
        # Output names depend on all files, not on the patterns or the list.
        names = TreeNames(chain(self._names(media), self._neighbours() if is_list else ()))
        count, unmatched = len(self._inputs), len(self._inputs) - len(self._intrinsics)
        if not self._has_inputs:
            _check_any([*self._skipped], where)
        cameras = self._cameras
        return BatchPlan(
            out=paths.path_of(self._out),
            inputs=tuple(self._inputs.values()),
            names=names,
            skipped=tuple(self._skipped),
            loops=loops,
            inputs_in_out=frozenset(self._inputs_in_out),
            shard=self._shard,
            intrinsics=self._intrinsics,
            stems=self._stems,
            is_part=is_list or bool(self._wanted.include or self._wanted.exclude),
            camera_warnings=tuple(cameras.warnings(count, unmatched)) if cameras else (),
        )

    def _names(self, media: Iterable[listing.InputFile]) -> Iterator[str]:
        places, inside = listing.RealPaths(), os.path.join(os.path.realpath(self._out), "")  # noqa: PTH118
        for found in media:
            yield found.name
            reason = None if found.problem else self._wanted.refusal(found.name)
            if reason is not None:
                self.skip(listing.Skipped(found.name, reason))
                continue
            self._has_inputs = True
            if not listing.is_video(found.name):
                self._stems.add(found.name)
            camera = self._cameras.camera_of(found.name) if self._cameras else None
            self._inputs_in_out.update(p for p in places.all_of(found.path) if p.startswith(inside))
            if self._shard.holds(found.name):
                self._add_input(found, places)
                if camera is not None:
                    self._intrinsics[found.name] = camera

    def _neighbours(self) -> Iterator[str]:
        """Names of the pictures and videos beside the inputs whose outputs could collide."""
        folders: dict[tuple[str, str], list[str]] = {}
        for found in self._inputs.values():
            if found.problem is None:
                above, slash, name = found.name.rpartition("/")
                folder = os.path.dirname(found.path)  # noqa: PTH120 - may be a URI
                folders.setdefault((folder, above + slash), []).append(name)
        for (folder, above), own in folders.items():
            for other in namesakes(paths.path_of(folder), own):
                path = paths.join(folder, other)
                if listing.why_skipped(path) is None and not os.path.isdir(path):  # noqa: PTH112
                    yield above + other

    def _add_input(self, found: listing.InputFile, places: listing.RealPaths) -> None:
        first = self._inputs.setdefault(found.name, found)
        if first is found:
            return
        if places.of(first.path) != places.of(found.path):  # outside the list's folder
            problem = f"{first.path} and {found.path} would both become {found.name}"
            raise UsageError(problem, "list them for batches with different {out}")
        self.skip(listing.Skipped(found.name, listing.TWICE))


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
    wanted: listing.NameFilter = listing.ANY,
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
    collector = InputCollector(out, wanted, shard, cameras)
    tree = listing.list_folder(root, leave_out=out, skip=wanted.excludes)
    media = list(tree.media)
    if media and media[0].name == ".":
        raise UsageError(f"{media[0].problem}")
    for file in tree.skipped:
        is_archive = file.reason in listing.ARCHIVE_SUFFIXES
        if tree.media or not is_archive or listing.is_own_output(file.name):
            collector.skip(file)
        else:  # a data set in archives alone
            media.append(listing.InputFile(file.name, paths.join(root, file.name)))
    return collector.plan(media, paths.safe_name(root), loops=tuple(tree.loops))


def plan_files(
    words: Iterable[str],
    source: str,
    root: str | os.PathLike[str] | None,
    out: str | os.PathLike[str],
    wanted: listing.NameFilter = listing.ANY,
    shard: Shard = WHOLE,
    cameras: CameraTable | None = None,
) -> BatchPlan:
    """Plan the files of a list, with any suffix; ``source`` is the name of the list in messages.

    Their folders are listed, so that their outputs have the names that a batch of the folder gives.
    Relative paths start from ``root``, whose tree is kept; None for the working directory, while
    absolute paths keep all their folders. Files of other shards take no memory.
    """
    root = None if root is None else paths.without_file_scheme(root)
    collector = InputCollector(paths.without_file_scheme(out), wanted, shard, cameras)

    def pictures() -> Iterator[listing.InputFile]:
        for found in listed_inputs(words, root):
            if found.problem is None and listing.is_own_output(found.path):
                collector.skip(listing.Skipped(found.name, listing.OWN))
            else:
                yield found

    plan = collector.plan(pictures(), f"the list {paths.safe_name(source)}", is_list=True)
    # So that nothing depends on the order of the list.
    return replace(plan, inputs=tuple(sorted(plan.inputs)))
