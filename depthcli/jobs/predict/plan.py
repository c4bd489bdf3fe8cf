"""The output files of ``depthcli predict``."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from depthcli.errors import UsageError
from depthcli.io.formats.table import FILE_SUFFIXES, Format, format_of, stem_of
from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.io.storage.paths import path_of, safe_name
from depthcli.jobs.outputs import STDIO, Destination, FormatRules, Kind, plan_outputs

_RULES = FormatRules(
    (Format.PNG16, Format.PREVIEW), format_of, stem_of, FILE_SUFFIXES, stdout=Format.PNG16
)


def split_own_outputs(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Inputs, and those to skip because depthcli wrote them; ``*.png`` matches these as well.

    Raises:
        UsageError: all of them were written by depthcli.
    """
    own = [name for name in names if name != STDIO and is_own_picture(name)]
    others = [name for name in names if name not in own]
    if not others:
        raise UsageError(
            f"{safe_name(own[0])} was written by depthcli; name a picture, or use "
            "'depthcli convert' for depth files"
        )
    return others, own


class PicturePlan(NamedTuple):
    """One input and its outputs."""

    name: str  #: the input as the user wrote it
    source: Path | None  #: the file; None for standard input
    outputs: dict[Format, Path | None]  #: the file of each format; None for standard output


def picture_destination(
    output: str | None, asked: Sequence[Format], *, sidecar: bool = False
) -> Destination[Format]:
    """Where the outputs of pictures go, and their formats.

    Raises:
        UsageError: as :meth:`Destination.parse` does.
    """
    return Destination.parse(output, asked, _RULES, Format.JSON if sidecar else None)


def plan_pictures(
    names: Sequence[str], destination: Destination[Format]
) -> tuple[PicturePlan, ...]:
    """Name every output before anything is read.

    Raises:
        UsageError: the outputs do not fit the inputs, or collide.
    """
    if list(names).count(STDIO) > 1:
        raise UsageError("'-' is standard input and can be read once; give it once")
    sources = [None if name == STDIO else path_of(name) for name in names]
    if destination.kind is Kind.STDOUT:
        if len(names) != 1 or len(destination.wanted) != 1:
            raise UsageError(
                "standard output takes one input and one format",
                "name a folder for more",
                option="out",
            )
        return (PicturePlan(safe_name(names[0]), sources[0], dict.fromkeys(destination.wanted)),)
    return tuple(
        PicturePlan(safe_name(name), plan.source, {**plan.outputs})
        for name, plan in zip(names, plan_outputs(sources, destination), strict=True)
    )
