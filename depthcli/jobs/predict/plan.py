"""Which files ``depthcli predict`` writes."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from depthcli.errors import UsageError
from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.io.writers.formats import ENDINGS, FORMATS, Format, format_of
from depthcli.jobs.naming import check_fit, is_folder, plan_outputs

STANDARD = "-"
DEFAULT_FORMATS = (Format.PNG16, Format.PREVIEW)


def pictures_among(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Inputs, and those left out because depthcli wrote them: ``*.png`` names them as well.

    Raises:
        UsageError: nothing else is there.
    """
    own = [name for name in names if name != STANDARD and is_own_picture(name)]
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


def picture_formats(output: str | None, asked: Sequence[Format]) -> tuple[Format, ...]:
    """What to write: what was asked for, else what the output's suffix says, else the default.

    Raises:
        UsageError: the output is empty, or a file whose suffix says nothing or another format.
    """
    if output == "":
        raise UsageError("-o is empty; name a file or a folder, or omit -o")
    if asked:
        if output is not None and len(set(asked)) == 1:
            check_fit("-o ", output, asked[0])
        return tuple(dict.fromkeys(asked))
    if output is None or is_folder(output):
        return DEFAULT_FORMATS
    if output == STANDARD:
        return (Format.PNG16,)
    found = format_of(output)
    if found is None:
        raise UsageError(
            f"-o {safe_name(output)} has no suffix that selects a format; use "
            f"{', '.join(ENDINGS)}, give --format, or end the name in '/' for a folder"
        )
    return (found,)


def plan_pictures(
    names: Sequence[str], output: str | None, formats: Sequence[Format], *, sidecar: bool
) -> tuple[PicturePlan, ...]:
    """Name every output before anything is read.

    Raises:
        UsageError: the outputs do not fit the inputs, or each other.
    """
    if list(names).count(STANDARD) > 1:
        raise UsageError("'-' is standard input and can be read once; give it once")
    sources = [None if name == STANDARD else path_of(name) for name in names]
    wanted = dict.fromkeys([*formats, Format.JSON] if sidecar else formats)
    if output == STANDARD:
        if len(names) != 1 or len(wanted) != 1:
            raise UsageError("-o - takes one input and one format; name a folder for more")
        return (PicturePlan(safe_name(names[0]), sources[0], dict.fromkeys(wanted)),)
    # A sidecar beside the one file that the user named must not change that file's name.
    beside = sidecar and len(formats) == 1 and output is not None and not is_folder(output)
    main = formats if beside else wanted
    plans = plan_outputs(sources, output, {name: FORMATS[name].suffix for name in main})
    pictures = [
        PicturePlan(
            safe_name(name), plan.source, {Format(key): path for key, path in plan.outputs.items()}
        )
        for name, plan in zip(names, plans, strict=True)
    ]
    if beside and output is not None:
        json_path = str(path_of(output).with_suffix(".json"))
        if is_folder(json_path):
            raise UsageError(f"the sidecar {safe_name(json_path)} is a folder; choose another -o")
        (plan,) = plan_outputs(sources, json_path, {Format.JSON: ""})
        pictures[0].outputs[Format.JSON] = plan.outputs[Format.JSON]
    return tuple(pictures)
