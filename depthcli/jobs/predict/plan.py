"""The output files of ``depthcli predict``."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from depthcli.errors import UsageError
from depthcli.io.formats.table import FILE_SUFFIXES, FORMATS, Format, format_of
from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.io.storage.paths import path_of, safe_name
from depthcli.jobs.naming import check_suffix, is_folder, plan_outputs, refuse_pattern

STDIO = "-"
DEFAULT_FORMATS = (Format.PNG16, Format.PREVIEW)


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


def picture_formats(output: str | None, asked: Sequence[Format]) -> tuple[Format, ...]:
    """The formats to write: the requested ones, else that of the output's suffix, else the default.

    Raises:
        UsageError: the output is empty, a pattern such as ``%04d``, or a file whose suffix is of no
            format or another one.
    """
    if output == "":
        raise UsageError("-o is empty; name a file or a folder, or omit -o")
    if output is not None:
        refuse_pattern("-o ", output)
    if asked:
        if output is not None and len(set(asked)) == 1:
            check_suffix("-o ", output, asked[0])
        return tuple(dict.fromkeys(asked))
    if output is None or is_folder(output):
        return DEFAULT_FORMATS
    if output == STDIO:
        return (Format.PNG16,)
    found = format_of(output)
    if found is None:
        raise UsageError(
            f"-o {safe_name(output)} has no suffix that selects a format; use "
            f"{', '.join(FILE_SUFFIXES)}, give --format, or end the name in '/' for a folder"
        )
    return (found,)


def plan_pictures(
    names: Sequence[str], output: str | None, formats: Sequence[Format], *, sidecar: bool
) -> tuple[PicturePlan, ...]:
    """Name every output before anything is read.

    Raises:
        UsageError: the outputs do not fit the inputs, or collide.
    """
    if list(names).count(STDIO) > 1:
        raise UsageError("'-' is standard input and can be read once; give it once")
    sources = [None if name == STDIO else path_of(name) for name in names]
    wanted = dict.fromkeys([*formats, Format.JSON] if sidecar else formats)
    if output == STDIO:
        if len(names) != 1 or len(wanted) != 1:
            raise UsageError("-o - takes one input and one format; name a folder for more")
        return (PicturePlan(safe_name(names[0]), sources[0], dict.fromkeys(wanted)),)
    # A sidecar must not change the name that the user gave for the output.
    beside = sidecar and len(formats) == 1 and output is not None and not is_folder(output)
    main = formats if beside else wanted
    plans = plan_outputs(sources, output, {name: FORMATS[name].suffix for name in main})
    pictures = [
        PicturePlan(
            safe_name(name), plan.source, {Format(key): path for key, path in plan.outputs.items()}
        )
        for name, plan in zip(names, plans, strict=True)
    ]
    if beside:
        (written,) = plans[0].outputs.values()
        json_path = str(written.with_suffix(".json"))
        if is_folder(json_path):
            raise UsageError(f"the sidecar {safe_name(json_path)} is a folder; choose another -o")
        (plan,) = plan_outputs(sources, json_path, {Format.JSON: ""})
        pictures[0].outputs[Format.JSON] = plan.outputs[Format.JSON]
    return tuple(pictures)
