"""Planning a batch of a folder or a list."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from depthcli.errors import UsageError
from depthcli.io.listing.folder import InputFile, list_folder
from depthcli.io.listing.globs import ANY, NameFilter
from depthcli.io.listing.own_outputs import is_own_output
from depthcli.io.listing.path_list import listed_inputs
from depthcli.io.listing.skipped import (
    OWN,
    Skipped,
)
from depthcli.io.listing.store import list_objects, walk_sort_key
from depthcli.io.manifest.shard import WHOLE, Shard
from depthcli.io.storage.remote import (
    RemotePath,
    path_of,
    safe_name,
    without_file_scheme,
)
from depthcli.jobs.batch.cameras import CameraTable
from depthcli.jobs.batch.input_collector import InputCollector
from depthcli.jobs.batch.input_plan import Plan


def plan_folder(
    root: str | os.PathLike[str],
    out: str | os.PathLike[str],
    wanted: NameFilter = ANY,
    shard: Shard = WHOLE,
    cameras: CameraTable | None = None,
) -> Plan:
    """Plan all pictures and videos in a folder tree.

    Raises:
        UsageError: there is no such folder, outputs would become inputs, the patterns exclude
            everything, or the table of cameras is of other inputs.
        InputError: there are files, but no picture or video that can be read.
    """
    root, out = without_file_scheme(root), without_file_scheme(out)
    place = path_of(root)
    is_store = isinstance(place, RemotePath) and not place.is_http  # checked when it is listed
    if not is_store and not place.is_dir():
        is_file = not isinstance(place, RemotePath) and place.is_file()
        hint = "; 'depthcli predict' and 'depthcli video' take files" if is_file else ""
        raise UsageError(f"{place} is not a folder; name one, or give --files with a list{hint}")
    if os.path.realpath(root) == os.path.realpath(out):  # the next run would read the outputs
        raise UsageError(
            f"--out {out} is the folder of the inputs; choose another folder, for example one "
            f"inside it"
        )
    collector = InputCollector(out, wanted, shard, cameras)
    if isinstance(place, RemotePath):
        objects = list_objects(place, path_of(out), wanted.excludes, collector.skip)
        plan = collector.plan(objects, safe_name(root))
        # In the order of a local folder, not in that of the store.
        inputs = sorted(plan.inputs, key=lambda one: walk_sort_key(one.name))
        plan = replace(plan, inputs=tuple(inputs))
    else:
        listing = list_folder(root, leave_out=out, skip=wanted.excludes)
        for file in listing.skipped:
            collector.skip(file)
        plan = collector.plan(listing.media, root, loops=listing.loops)
    _check_outside(plan, root)
    return plan


def plan_files(
    words: Iterable[str],
    source: str,
    root: str | os.PathLike[str] | None,
    out: str | os.PathLike[str],
    wanted: NameFilter = ANY,
    shard: Shard = WHOLE,
    cameras: CameraTable | None = None,
) -> Plan:
    """Plan the files of a list, with any suffix.

    Their folders are listed, so that their outputs have the names that a batch of the folder gives.

    Args:
        words: the paths of the list.
        source: name of the list in messages.
        root: the folder that relative paths start from, and whose tree is kept; None for the
            working directory, while absolute paths keep all their folders.
        out: the output folder.
        wanted: include and exclude patterns.
        shard: the part of them that is planned; the others take no memory.
        cameras: their focal lengths, if known.

    Raises:
        UsageError: the patterns exclude everything, or the table of cameras is of other inputs.
        InputError: all listed files are outputs of depthcli.
    """
    root = None if root is None else without_file_scheme(root)
    out = without_file_scheme(out)
    collector = InputCollector(out, wanted, shard, cameras)

    def pictures() -> Iterator[InputFile]:
        for found in listed_inputs(words, root):
            if found.problem is None and is_own_output(found.path):
                collector.skip(Skipped(found.name, OWN))
            else:
                yield found

    plan = collector.plan(pictures(), f"the list {safe_name(source)}", is_list=True)
    # So that nothing depends on the order of the list.
    return replace(plan, inputs=tuple(sorted(plan.inputs)))


def _check_outside(plan: Plan, root: str) -> None:
    """Refuse outputs that would lie among the inputs, through a link for example."""
    inside, out = (Path(os.path.realpath(folder)) for folder in (root, plan.out))
    for folder in plan.folders():
        real = Path(os.path.realpath(folder))
        # The output folder itself may lie in the input folder, as it is not read.
        apart = real.is_relative_to(out) and not inside.is_relative_to(out)
        if real.is_relative_to(inside) and not apart:
            raise UsageError(
                f"outputs in {folder} would lie among the inputs; choose another --out"
            )
