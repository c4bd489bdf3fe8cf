"""What a batch is to do: its inputs, and the names of their outputs."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.errors import InputError, UsageError
from depthcli.io.listing.folder import InputFile, is_video, list_folder
from depthcli.io.listing.globs import ANY, NameFilter
from depthcli.io.listing.own_outputs import is_own_output
from depthcli.io.listing.path_list import listed_inputs, parse_list
from depthcli.io.listing.skipped import (
    EXCLUDED,
    NOT_INCLUDED,
    OWN,
    Skipped,
    counted,
    to_convert,
)
from depthcli.jobs.tree_names import TreeNames

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


@dataclass(frozen=True, slots=True)
class Plan:
    """All inputs of a batch.

    Attributes:
        out: the output folder.
        inputs: in an order that depends on their names alone.
        names: what their outputs are called.
        skipped: files that are no inputs.
        loops: folders that lead back to a folder that they are in.
        unmatched: patterns of ``--include`` that no picture or video matches.
    """

    out: Path
    inputs: tuple[InputFile, ...]
    names: TreeNames
    skipped: tuple[Skipped, ...]
    loops: tuple[str, ...] = ()
    unmatched: tuple[str, ...] = ()

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


def plan_folder(root: str, out: str, wanted: NameFilter = ANY) -> Plan:
    """Plan for all pictures and videos below a folder.

    Raises:
        UsageError: there is no such folder, outputs would become inputs, or the patterns leave
            nothing.
        InputError: there are files, but no picture or video that can be read.
    """
    if not Path(root).is_dir():
        raise UsageError(f"{root} is not a folder; name one, or give --files with a list")
    _check_apart(root, out)
    listing = list_folder(root, leave_out=out, skip=wanted.excludes)
    # Names are decided over all that is there, so that they do not depend on what is wanted today.
    names = TreeNames(found.name for found in listing.media)
    inputs, unwanted = _divided(listing.media, wanted)
    skipped = (*listing.skipped, *unwanted)
    unmatched = wanted.unmatched([found.name for found in listing.media])
    plan = Plan(Path(out), inputs, names, skipped, listing.loops, unmatched)
    _check_outside(plan, root)
    _check_any(plan, root)
    return plan


def plan_files(data: bytes, source: str, root: str, out: str, wanted: NameFilter = ANY) -> Plan:
    """Plan for listed files, whatever their suffix.

    Args:
        data: one path a line, or one before each NUL.
        source: what messages call the list.
        root: the folder that listed paths start from, and whose tree is kept.
        out: the output folder.
        wanted: which names are taken.

    Raises:
        UsageError: the patterns leave nothing.
        InputError: it lists nothing but outputs of depthcli.
    """
    listed = listed_inputs(parse_list(data), root)
    own = {found for found in listed if is_own_output(found.path)}
    pictures = [found for found in listed if found not in own]
    inputs, unwanted = _divided(pictures, wanted)
    skipped = (*(Skipped(found.name, OWN) for found in own), *unwanted)
    names = TreeNames(found.name for found in pictures)
    unmatched = wanted.unmatched([found.name for found in pictures])
    plan = Plan(Path(out), inputs, names, skipped, unmatched=unmatched)
    _check_any(plan, f"the list {source}")
    return plan


def _divided(
    media: Iterable[InputFile], wanted: NameFilter
) -> tuple[tuple[InputFile, ...], tuple[Skipped, ...]]:
    """Inputs, and what the patterns leave out."""
    inputs, unwanted = [], []
    for found in media:
        reason = None if found.problem else wanted.refusal(found.name)
        if reason is None:
            inputs.append(found)
        else:
            unwanted.append(Skipped(found.name, reason))
    return tuple(inputs), tuple(unwanted)


def _check_any(plan: Plan, where: str) -> None:
    """Nothing to do is no success where there was something."""
    if plan.inputs or not plan.skipped:
        return
    if {NOT_INCLUDED, EXCLUDED} & {file.reason for file in plan.skipped}:
        raise UsageError(
            f"--include and --exclude leave nothing of {where}: {counted(plan.skipped)}"
        )
    hint = to_convert(plan.skipped)
    raise InputError(
        f"no picture or video in {where}: {counted(plan.skipped)}{'; ' + hint if hint else ''}"
    )


def _check_apart(root: str, out: str) -> None:
    """Outputs among the inputs would be read as pictures by the next run."""
    if _real(root) == _real(out):
        raise UsageError(
            f"--out {out} is the folder of the inputs; choose another folder, for example one "
            f"inside it"
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
