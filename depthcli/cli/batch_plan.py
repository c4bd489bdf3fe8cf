"""What a batch is to do: its inputs, and the names of their outputs."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from depthcli.errors import UsageError
from depthcli.io.sources.folder import Found, is_video, list_folder
from depthcli.io.sources.path_list import locate, parse_list
from depthcli.io.tree_naming import TreeNames

if TYPE_CHECKING:
    from collections.abc import Iterator

    from depthcli.io.globs import NameFilter

STANDARD = "-"


class Plan(NamedTuple):
    """All inputs of a batch.

    Attributes:
        out: the output folder.
        inputs: in an order that depends on their names alone.
        names: what their outputs are called.
        skipped_count: files left alone: neither pictures nor videos, or not wanted.
        loops: folders that lead back to a folder that they are in.
    """

    out: Path
    inputs: tuple[Found, ...]
    names: TreeNames
    skipped_count: int
    loops: tuple[str, ...]

    @property
    def pictures(self) -> Iterator[Found]:
        """Everything but videos."""
        return (found for found in self.inputs if not is_video(found.name))

    @property
    def videos(self) -> Iterator[Found]:
        """The videos."""
        return (found for found in self.inputs if is_video(found.name))

    def folders(self) -> set[Path]:
        """Where outputs go."""
        return {self.out, *((self.out / found.name).parent for found in self.inputs)}


def plan_folder(root: str, out: str, wanted: NameFilter) -> Plan:
    """Plan for all pictures and videos below a folder.

    Raises:
        UsageError: there is no such folder, or outputs would become inputs.
    """
    if not Path(root).is_dir():
        raise UsageError(f"{root} is not a folder; name one, or give --files with a list")
    _check_apart(root, out)
    listing = list_folder(root, leave_out=out, skip=wanted.leaves)
    # Names are decided over all that is there, so that they do not depend on what is wanted today.
    names = TreeNames(found.name for found in listing.media)
    inputs = tuple(f for f in listing.media if f.problem or wanted.takes(f.name))
    skipped_count = listing.other_count + len(listing.media) - len(inputs)
    plan = Plan(Path(out), inputs, names, skipped_count, listing.loops)
    _check_outside(plan, root)
    return plan


def plan_files(source: str, root: str, out: str, wanted: NameFilter) -> Plan:
    """Plan for listed files, whatever their suffix.

    Args:
        source: a file with one path a line; ``-`` for standard input.
        root: the folder that listed paths start from, and whose tree is kept.
        out: the output folder.
        wanted: which names are taken.

    Raises:
        UsageError: the list cannot be read.
    """
    try:
        data = sys.stdin.buffer.read() if source == STANDARD else Path(source).read_bytes()
    except OSError as error:
        raise UsageError(f"cannot read the list {source}: {error.strerror}") from error
    listed = locate(parse_list(data), root)
    inputs = tuple(found for found in listed if wanted.takes(found.name))
    names = TreeNames(found.name for found in listed)
    return Plan(Path(out), inputs, names, len(listed) - len(inputs), ())


def _check_apart(root: str, out: str) -> None:
    """Outputs among the inputs would be read as pictures by the next run."""
    if _real(root) == _real(out):
        raise UsageError(
            f"--out {out} is the folder of the inputs; name another, a folder in it say"
        )


def _check_outside(plan: Plan, root: str) -> None:
    """The same where the outputs' tree happens to lead into the inputs', by a link say."""
    inside, out = Path(_real(root)), Path(_real(str(plan.out)))
    for folder in plan.folders():
        real = Path(_real(str(folder)))
        # A folder for outputs within the inputs' is never read, so that it may lie there.
        apart = real.is_relative_to(out) and not inside.is_relative_to(out)
        if real.is_relative_to(inside) and not apart:
            raise UsageError(
                f"outputs in {folder} would lie among the inputs; choose another --out"
            )


def _real(path: str) -> str:
    return os.path.realpath(path)
