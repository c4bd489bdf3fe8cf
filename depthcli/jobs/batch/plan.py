"""Planning a batch of a folder or a list, or of what changes in a folder."""

import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event

from depthcli.core.camera import Intrinsics
from depthcli.core.options import SceneLayout, short_repr
from depthcli.errors import DepthcliError, InputError, UsageError
from depthcli.io import calibration, guard, listing, manifest, media
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.storage import paths
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
    shard: manifest.Shard = manifest.WHOLE  #: the part of the inputs that is planned
    #: cameras of a table, by input; the others are not in it
    intrinsics: Mapping[str, Intrinsics] = field(default_factory=dict)
    same_stem: frozenset[str] = frozenset()  #: images whose stem is that of another image
    is_part: bool = False  #: whether other files of the folder may be inputs of other batches
    warnings: tuple[str, ...] = ()  #: before the start, one line each

    @property
    def images(self) -> Iterator[listing.InputFile]:
        """The images: all inputs but videos and archives."""
        return (file for file in self.inputs if not holds_many(file.name))

    @property
    def videos(self) -> Iterator[listing.InputFile]:
        """The videos, and the archives of images."""
        return (file for file in self.inputs if holds_many(file.name))


def holds_many(name: str) -> bool:
    """Whether a name is a video's, or that of an archive of images."""
    return media.is_video(name) or media.is_archive(name)


_OUTPUT_SUFFIXES = (
    *(format_.facts.suffix for format_ in (*Format, *VideoFormat)),
    *(f".depth{suffix}" for suffix in media.ARCHIVE_SUFFIXES),
)


def _planned(
    files: Iterable[tuple[listing.InputFile, str | None]],
    where: str,
    out: str,
    names_filter: listing.NameFilter,
    shard: manifest.Shard,
    cameras: str | None,
    loops: tuple[str, ...] = (),
    *,
    is_list: bool = False,
) -> BatchPlan:
    """The plan of files, each with why it is no input; the order of a list does not count."""
    paths.check_writable(paths.path_of(out))
    places = listing.RealPaths()
    inputs, skipped = dict[str, listing.InputFile](), dict[listing.Skipped, None]()
    all_names, like_outputs = set[str](), set[str]()
    for file, refusal in files:
        reason = refusal or (None if file.problem else names_filter.refusal(file.name))
        if reason is None:
            all_names.add(file.name)
            like_outputs.update(p for p in places.all_of(file.path) if p.endswith(_OUTPUT_SUFFIXES))
        if not shard.holds(file.name):
            continue
        first = file if reason else inputs.setdefault(file.name, file)
        if first is not file:
            if places.of(first.path) != places.of(file.path):  # outside the list's folder
                problem = f"{first.path} and {file.path} would both become {file.name}"
                raise UsageError(problem, "list them for batches with different {out}")
            reason = listing.TWICE
        if reason is not None:
            skipped[listing.Skipped(file.name, reason)] = None
    if skipped and not all_names:
        raise _nothing_left([*skipped], where)
    names = OutputNames(all_names)
    intrinsics, warnings = _lenses(cameras, all_names, inputs)
    if unreadable := listing.conversion_hint(tuple(skipped)):
        warnings.append(unreadable)
    return BatchPlan(
        out=paths.path_of(out),
        inputs=tuple(sorted(inputs.values()) if is_list else inputs.values()),
        names=names,
        skipped=tuple(skipped),
        loops=loops,
        like_outputs=frozenset(like_outputs),
        shard=shard,
        intrinsics=intrinsics,
        same_stem=sharing_stem(name for name in names.longer if not media.is_video(name)),
        is_part=is_list or bool(names_filter.include or names_filter.exclude),
        warnings=tuple(warnings),
    )


def _lenses(
    source: str | None, names: Iterable[str], inputs: Collection[str]
) -> tuple[dict[str, Intrinsics], list[str]]:
    """Cameras of inputs by a table, and a warning; UsageError if none of all names has a row."""
    if source is None:
        return {}, []
    try:
        table = calibration.read_lenses(paths.path_of(source))
    except InputError as error:
        raise UsageError(str(error), option="cameras") from error
    rows = {name: name if name in table else stem(name) for name in names}
    if table and inputs and set(table).isdisjoint(rows.values()):
        first = short_repr(next(iter(table)))
        raise UsageError(
            f"no row of {source} with a camera matches an input; an id is the path of an input "
            f"from the folder, with or without its suffix, but the first is {first}"
        )
    found = {name: table[rows[name]] for name in inputs if rows[name] in table}
    problem = f"{source} has no camera for {len(inputs) - len(found)} of {len(inputs)} inputs; "
    problem += "their focal lengths are those in EXIF, or assumed"
    return found, [problem] if len(found) < len(inputs) else []


def _nothing_left(skipped: Sequence[listing.Skipped], where: str) -> DepthcliError:
    reasons, summary = {file.reason for file in skipped}, listing.skip_summary(skipped)
    if {listing.NOT_INCLUDED, listing.EXCLUDED} & reasons:
        return UsageError(f"nothing of {where} is left: {summary}", "change {include} or {exclude}")
    hint = listing.conversion_hint(skipped) or ""
    if not hint and ".exr" in reasons:
        hint = "EXR is read by 'predict', by 'video' (a sequence), and by 'batch' from a list"
    return InputError(f"no image or video in {where}: {summary}", hint)


def plan_folder(
    root: str | os.PathLike[str],
    out: str | os.PathLike[str],
    names_filter: listing.NameFilter = listing.ANY,
    shard: manifest.Shard = manifest.WHOLE,
    cameras: str | None = None,
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
        advice = "name one, or give {files} a list; 'predict' and 'video' take files"
        raise UsageError(f"{place} is not a folder", advice)
    if os.path.realpath(root) == os.path.realpath(out):  # the next run would read the outputs
        advice = "choose another folder, for example one inside it"
        raise UsageError(f"{out} is the folder of the inputs", advice, option="out")
    tree = listing.list_folder(root, leave_out=out, skip=names_filter.excludes)
    if tree.media and tree.media[0].name == ".":
        raise UsageError(f"{tree.media[0].problem}")
    files = list[tuple[listing.InputFile, str | None]]()
    for name, reason in tree.skipped:
        # A data set may be in archives alone.
        is_input = (
            not tree.media and reason in media.ARCHIVE_SUFFIXES and not guard.is_own_output(name)
        )
        file = listing.InputFile(name, paths.join(root, name))
        files.append((file, None if is_input else reason))
    files += [(file, None) for file in tree.media]
    where, loops = paths.safe_name(root), tuple(tree.loops)
    return _planned(files, where, out, names_filter, shard, cameras, loops)


def plan_files(
    words: Iterable[str],
    source: str,
    root: str | os.PathLike[str] | None,
    out: str | os.PathLike[str],
    names_filter: listing.NameFilter = listing.ANY,
    shard: manifest.Shard = manifest.WHOLE,
    cameras: str | None = None,
) -> BatchPlan:
    """Plan the files of a list, with any suffix; ``source`` is the name of the list in messages.

    Relative paths start from ``root``, whose tree is kept; None for the working directory, while
    absolute paths keep all their folders. Of the files of other shards, only names are kept.
    """
    root = None if root is None else paths.without_file_scheme(root)
    files = (
        (file, listing.OWN if file.problem is None and guard.is_own_output(file.path) else None)
        for file in listing.listed_inputs(words, root)
    )
    where, out = f"the list {paths.safe_name(source)}", paths.without_file_scheme(out)
    return _planned(files, where, out, names_filter, shard, cameras, is_list=True)


_FAR_M = 1e9  # whose inverse is 0: an image's scale depends on its nearest pixel alone


def scene_format(layout: SceneLayout, writing: WriterOptions) -> tuple[Format, WriterOptions]:
    """The format of a layout; for 3D Gaussian splatting its options are inverse depth, from 0."""
    if layout is SceneLayout.COLMAP:
        return Format.COLMAP, writing
    return Format.PNG16, replace(writing, png_inverse=True, vmax=writing.vmax or _FAR_M)


_SETTLE_S = 1.0
_LOOK_MS = 500


def changes_of(
    folder: str, out: str, names_filter: listing.NameFilter
) -> Callable[[Event], Iterator[BatchPlan]]:
    """Plans of the images and videos of a folder that are new or changed from now on.

    The plans come until the event is set. A file is new or changed when its size and time have
    stayed the same for a second, so that it is complete.
    """
    from watchfiles import watch  # noqa: PLC0415 - an extra

    def stamps() -> dict[str, tuple[int, int, int]]:
        """Size, time of the last change and inode of each file."""
        stamps = {}
        for file in listing.list_folder(folder, leave_out=out, skip=names_filter.excludes).media:
            if file.problem is None and names_filter.refusal(file.name) is None:
                with suppress(OSError):  # it has gone again
                    status = os.stat(file.path)  # noqa: PTH116 - a path as text
                    stamps[file.name] = status.st_size, status.st_mtime_ns, status.st_ino
        return stamps

    def plans(stop: Event) -> Iterator[BatchPlan]:
        since_s: dict[tuple[str, tuple[int, int, int]], float] = {}
        is_first = True  # what came before the folder was watched is no change of it
        for changes in watch(
            folder,
            stop_event=stop,
            rust_timeout=_LOOK_MS,
            yield_on_timeout=True,
            raise_interrupt=False,
        ):
            if not (changes or since_s or is_first):
                continue
            is_first, now_s, present = False, time.monotonic(), stamps()
            since_s = {file: since_s.get(file, now_s) for file in present.items() - done.items()}
            settled = dict(file for file, at_s in since_s.items() if now_s - at_s >= _SETTLE_S)
            done.update(settled)
            if settled:
                plan = plan_files(present, folder, folder, out, names_filter)
                files = (file for file in plan.inputs if file.name in settled)
                yield replace(plan, inputs=tuple(files), skipped=())

    done = stamps()
    return plans
