"""Collecting the inputs of a batch, and the files that are skipped."""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING

from depthcli.errors import InputError, UsageError
from depthcli.io.listing.folder import InputFile, is_video, why_skipped
from depthcli.io.listing.globs import NameFilter
from depthcli.io.listing.real_paths import RealPaths
from depthcli.io.listing.skipped import (
    EXCLUDED,
    NOT_INCLUDED,
    TWICE,
    Skipped,
    conversion_hint,
    exr_hint,
    skip_summary,
)
from depthcli.io.manifest.shard import Shard
from depthcli.io.storage.remote import (
    check_writable,
    join,
    path_of,
)
from depthcli.jobs.batch.cameras import CameraTable
from depthcli.jobs.batch.input_plan import Plan
from depthcli.jobs.namesakes import namesakes
from depthcli.jobs.tree_names import StemCounts, TreeNames

if TYPE_CHECKING:
    from depthcli.core.camera import Intrinsics


class InputCollector:
    """Collects the inputs of a shard and the files that are skipped."""

    def __init__(
        self, out: str, wanted: NameFilter, shard: Shard, cameras: CameraTable | None
    ) -> None:
        check_writable(path_of(out))
        self._out, self._wanted, self._shard, self._cameras = out, wanted, shard, cameras
        self._lenses: dict[str, Intrinsics] = {}
        self._inputs: dict[str, InputFile] = {}
        self._skipped: dict[Skipped, None] = {}
        self._inputs_in_out: set[str] = set()
        self._unlisted: dict[str, list[str]] = {}
        self._stems = StemCounts()
        self._has_inputs = False
        self._unmatched = list(zip(wanted.include_words, wanted.include, strict=True))

    def skip(self, file: Skipped) -> None:
        """Add a skipped file."""
        if self._shard.holds(file.name):
            self._skipped[file] = None

    def plan(
        self,
        media: Iterable[InputFile],
        where: str,
        loops: tuple[str, ...] = (),
        *,
        is_list: bool = False,
    ) -> Plan:
        """Make a plan of pictures and videos."""
        # Output names depend on all files, not on the patterns or the list.
        names = TreeNames(chain(self._names(media), self._neighbours() if is_list else ()))
        plan = Plan(
            path_of(self._out),
            tuple(self._inputs.values()),
            names,
            tuple(self._skipped),
            loops,
            tuple(word for word, _ in self._unmatched),
            frozenset(self._inputs_in_out),
            self._shard,
            self._unlisted,
            self._lenses,
            self._stems,
            is_list or bool(self._wanted.include or self._wanted.exclude),
        )
        if not self._has_inputs:
            _check_any(plan.skipped, where)
        if self._cameras is None:
            return plan
        unmatched = len(plan.inputs) - len(plan.lenses)
        warnings = tuple(self._cameras.warnings(len(plan.inputs), unmatched))
        return replace(plan, camera_warnings=warnings)

    def _names(self, media: Iterable[InputFile]) -> Iterator[str]:
        places, inside = RealPaths(), os.path.join(os.path.realpath(self._out), "")  # noqa: PTH118
        for found in media:
            yield found.name
            self._unmatched = [x for x in self._unmatched if not x[1].fullmatch(found.name)]
            reason = None if found.problem else self._wanted.refusal(found.name)
            if reason is not None:
                self.skip(Skipped(found.name, reason))
                continue
            self._has_inputs = True
            if not is_video(found.name):
                self._stems.add(found.name)
            lens = self._cameras.lens(found.name) if self._cameras else None
            self._inputs_in_out.update(p for p in places.all_of(found.path) if p.startswith(inside))
            if self._shard.holds(found.name):
                self._add_input(found, places)
                if lens is not None:
                    self._lenses[found.name] = lens

    def _neighbours(self) -> Iterator[str]:
        """Names of the pictures and videos beside the inputs whose outputs could collide."""
        folders: dict[tuple[str, str], list[str]] = {}
        for found in self._inputs.values():
            if found.problem is None:
                above, slash, name = found.name.rpartition("/")
                folder = os.path.dirname(found.path)  # noqa: PTH120 - may be a URI
                folders.setdefault((folder, above + slash), []).append(name)
        for (folder, above), own in folders.items():
            for name, others in namesakes(path_of(folder), own).items():
                there = [other for other in others if above + other not in self._inputs]
                if there:
                    self._unlisted[above + name] = [above + other for other in there]
                for other in there:
                    path = join(folder, other)
                    if why_skipped(path) is None and not os.path.isdir(path):  # noqa: PTH112
                        yield above + other

    def _add_input(self, found: InputFile, places: RealPaths) -> None:
        """Add an input, unless it is listed twice.

        Raises:
            UsageError: another file, outside the list's folder, has the same name.
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
    """Refuse a plan without inputs, unless there were no files at all."""
    if not skipped:
        return
    if {NOT_INCLUDED, EXCLUDED} & {file.reason for file in skipped}:
        raise UsageError(
            f"--include and --exclude leave nothing of {where}: {skip_summary(skipped)}"
        )
    hints = filter(None, (conversion_hint(skipped), exr_hint(skipped)))
    raise InputError(
        "; ".join((f"no picture or video in {where}: {skip_summary(skipped)}", *hints))
    )
