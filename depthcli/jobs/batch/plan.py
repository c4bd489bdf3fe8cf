"""What a batch is to do: its inputs, and the names of their outputs."""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from depthcli.errors import InputError, UsageError
from depthcli.io.listing.folder import InputFile, is_video, list_folder
from depthcli.io.listing.globs import ANY, NameFilter
from depthcli.io.listing.own_outputs import is_own_output
from depthcli.io.listing.path_list import listed_inputs
from depthcli.io.listing.places import Places
from depthcli.io.listing.skipped import (
    EXCLUDED,
    NOT_INCLUDED,
    OWN,
    TWICE,
    Skipped,
    counted,
    to_convert,
)
from depthcli.io.listing.store import list_objects, walk_order
from depthcli.io.manifest.shard import WHOLE, Shard
from depthcli.io.storage.remote import RemotePath, check_writable, path_of, plain_name, safe_name
from depthcli.jobs.tree_names import TreeNames


@dataclass(frozen=True, slots=True)
class Plan:
    """All inputs of a batch."""

    out: Path  #: the output folder
    inputs: tuple[InputFile, ...]  #: in an order that depends on their names alone
    names: TreeNames  #: what their outputs are called
    skipped: tuple[Skipped, ...]  #: files that are no inputs
    loops: tuple[str, ...] = ()  #: folders that lead back to a folder that they are in
    unmatched: tuple[str, ...] = ()  #: patterns of ``--include`` that no picture or video matches
    #: the places of inputs of any shard that lie in the output folder
    in_out: frozenset[str] = frozenset()
    shard: Shard = WHOLE  #: the part of the inputs that this is a plan for

    @property
    def warnings(self) -> Iterator[str]:
        """What is to be known before anything is done, one line each."""
        for word in self.unmatched:
            yield f"--include {word!r} matches no picture or video"
        unreadable = to_convert(self.skipped)
        if unreadable:
            yield unreadable

    @property
    def pictures(self) -> Iterator[InputFile]:
        """Everything but videos."""
        return (found for found in self.inputs if not is_video(found.name))

    @property
    def videos(self) -> Iterator[InputFile]:
        """The videos."""
        return (found for found in self.inputs if is_video(found.name))

    def folders(self) -> set[Path]:
        """Where outputs go."""
        return {self.out, *((self.out / found.name).parent for found in self.inputs)}


def plan_folder(root: str, out: str, wanted: NameFilter = ANY, shard: Shard = WHOLE) -> Plan:
    """Plan for all pictures and videos below a folder.

    Raises:
        UsageError: there is no such folder, outputs would become inputs, or the patterns leave
            nothing.
        InputError: there are files, but no picture or video that can be read.
    """
    root, out = plain_name(root), plain_name(out)
    place = path_of(root)
    is_store = isinstance(place, RemotePath) and not place.is_http  # listing it says what it is
    if not is_store and not place.is_dir():
        raise UsageError(f"{place} is not a folder; name one, or give --files with a list")
    if os.path.realpath(root) == os.path.realpath(out):  # the next run would read the outputs
        raise UsageError(
            f"--out {out} is the folder of the inputs; choose another folder, for example one "
            f"inside it"
        )
    sorting = _Sorting(out, wanted, shard)
    if isinstance(place, RemotePath):
        objects = list_objects(place, path_of(out), wanted.excludes, sorting.skip)
        plan = sorting.plan(objects, safe_name(root))
        # As a folder of this machine would be walked, whatever the store's order.
        inputs = sorted(plan.inputs, key=lambda one: walk_order(one.name))
        plan = replace(plan, inputs=tuple(inputs))
    else:
        listing = list_folder(root, leave_out=out, skip=wanted.excludes)
        for file in listing.skipped:
            sorting.skip(file)
        plan = sorting.plan(listing.media, root, loops=listing.loops)
    _check_outside(plan, root)
    return plan


def plan_files(
    words: Iterable[str],
    source: str,
    root: str,
    out: str,
    wanted: NameFilter = ANY,
    shard: Shard = WHOLE,
) -> Plan:
    """Plan for listed files, whatever their suffix.

    Args:
        words: the paths of the list.
        source: what messages call the list.
        root: the folder that listed paths start from, and whose tree is kept.
        out: the output folder.
        wanted: which names are taken.
        shard: the part of them that is planned; of the others nothing stays in memory.

    Raises:
        UsageError: the patterns leave nothing.
        InputError: it lists nothing but outputs of depthcli.
    """
    root, out = plain_name(root), plain_name(out)
    sorting = _Sorting(out, wanted, shard)

    def pictures() -> Iterator[InputFile]:
        for found in listed_inputs(words, root):
            if is_own_output(found.path):
                sorting.skip(Skipped(found.name, OWN))
            else:
                yield found

    plan = sorting.plan(pictures(), f"the list {safe_name(source)}")
    # Nothing depends on the order of the list.
    return replace(plan, inputs=tuple(sorted(plan.inputs)))


class _Sorting:
    """Tells inputs of a shard from others and from files that are skipped, one by one."""

    def __init__(self, out: str, wanted: NameFilter, shard: Shard) -> None:
        check_writable(path_of(out))
        self._out, self._wanted, self._shard = out, wanted, shard
        self._inputs: dict[str, InputFile] = {}
        self._skipped: dict[Skipped, None] = {}
        self._in_out: set[str] = set()
        self._has_inputs = False
        self._unmatched = list(zip(wanted.include_words, wanted.include, strict=True))

    def skip(self, file: Skipped) -> None:
        """Put a file aside."""
        if self._shard.holds(file.name):
            self._skipped[file] = None

    def plan(self, media: Iterable[InputFile], where: str, loops: tuple[str, ...] = ()) -> Plan:
        """Sort pictures and videos, and make a plan."""
        # Names are decided over all that is there, so that they do not depend on what is wanted.
        names = TreeNames(self._names(media))
        plan = Plan(
            path_of(self._out),
            tuple(self._inputs.values()),
            names,
            tuple(self._skipped),
            loops,
            tuple(word for word, _ in self._unmatched),
            frozenset(self._in_out),
            self._shard,
        )
        if not self._has_inputs:
            _check_any(plan.skipped, where)
        return plan

    def _names(self, media: Iterable[InputFile]) -> Iterator[str]:
        places, inside = Places(), os.path.join(os.path.realpath(self._out), "")  # noqa: PTH118
        for found in media:
            yield found.name
            self._unmatched = [x for x in self._unmatched if not x[1].fullmatch(found.name)]
            reason = None if found.problem else self._wanted.refusal(found.name)
            if reason is not None:
                self.skip(Skipped(found.name, reason))
                continue
            self._has_inputs = True
            self._in_out.update(p for p in places.all_of(found.path) if p.startswith(inside))
            if self._shard.holds(found.name):
                self._take(found, places)

    def _take(self, found: InputFile, places: Places) -> None:
        """An input; one of a list may be there already.

        Raises:
            UsageError: another file has its name, which is one outside the list's folder.
        """
        first = self._inputs.setdefault(found.name, found)
        if first is found:
            return
        if places.of(first.path) != places.of(found.path):
            raise UsageError(
                f"{first.path} and {found.path} would both become {found.name}; list them for "
                "batches with different --out"
            )
        self.skip(Skipped(found.name, TWICE))


def _check_any(skipped: Sequence[Skipped], where: str) -> None:
    """Nothing to do is no success where there was something."""
    if not skipped:
        return
    if {NOT_INCLUDED, EXCLUDED} & {file.reason for file in skipped}:
        raise UsageError(f"--include and --exclude leave nothing of {where}: {counted(skipped)}")
    hint = to_convert(skipped)
    raise InputError(
        f"no picture or video in {where}: {counted(skipped)}{'; ' + hint if hint else ''}"
    )


def _check_outside(plan: Plan, root: str) -> None:
    """Refuse outputs whose tree happens to lead into that of the inputs, by a link say."""
    inside, out = (Path(os.path.realpath(folder)) for folder in (root, plan.out))
    for folder in plan.folders():
        real = Path(os.path.realpath(folder))
        # A folder for outputs within the inputs' is never read, so that it may lie there.
        apart = real.is_relative_to(out) and not inside.is_relative_to(out)
        if real.is_relative_to(inside) and not apart:
            raise UsageError(
                f"outputs in {folder} would lie among the inputs; choose another --out"
            )
