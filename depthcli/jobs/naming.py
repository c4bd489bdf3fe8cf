"""Naming the outputs of each input, before anything is written."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from depthcli.errors import UsageError
from depthcli.io.formats.table import Format, file_suffix_of, fits, format_of, stem_of
from depthcli.io.listing.folder import RealPaths, is_exr, is_media
from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.io.storage.atomic import is_special
from depthcli.io.storage.paths import check_writable, path_of, safe_name
from depthcli.jobs.unique_names import namesakes
from depthcli.video.numbering import is_pattern

STDIN_STEM = "stdin"


class OutputPlan(NamedTuple):
    """The outputs of one input."""

    source: Path | None  #: the input; None for standard input
    outputs: dict[str, Path]  #: path of each format


def plan_outputs(
    sources: Sequence[Path | None], out: str | None, suffixes: Mapping[str, str]
) -> list[OutputPlan]:
    """Name every output.

    Without ``out``, outputs are placed beside their input. If another picture or video with the
    same stem is in the input's folder, or goes to the same folder, the output's name keeps the
    input's suffix (``a.jpg.depth.png``, ``a.png.depth.png``), so that names do not depend on the
    order or choice of the inputs.

    A folder without a name, such as ``.`` or ``/``, gets no outputs.

    Args:
        sources: the inputs; None is standard input, whose outputs go to the working directory.
        out: a file (for one input), or a folder, which exists or ends in ``/``. With several
            formats, or for a name without the suffix of a format, the formats' suffixes follow the
            file's stem.
        suffixes: of each format, such as ``.depth.png``.

    Raises:
        UsageError: two inputs share an output, an output is an input, or ``out`` is no folder but
            there are several inputs or formats.
    """
    if out is not None and not is_folder(out):
        plans = [_one_file(sources, path_of(out), suffixes)]
    else:
        plans = _in_folders(sources, None if out is None else path_of(out), suffixes)
    check_collisions(plans)
    return plans


def is_folder(out: str) -> bool:
    """Whether ``-o`` names a folder: it exists as one, or it ends in a separator."""
    return out.endswith(("/", os.sep)) or path_of(out).is_dir()


def check_suffix(option: str, name: str, asked: Format) -> None:
    """Check that a file name does not have the suffix of another format than the requested one.

    Raises:
        UsageError: it is the suffix of another format.
    """
    if not is_folder(name) and not fits(name, asked):
        raise UsageError(
            f"{option}{safe_name(name)} does not end in {file_suffix_of(asked)}; the suffix has to "
            f"match --format {asked}"
        )


def refuse_pattern(option: str, name: str) -> None:
    """Refuse the name of numbered files for one file.

    Raises:
        UsageError: the name has a placeholder such as ``%04d``.
    """
    if is_pattern(path_of(name).name) and not is_folder(name):
        raise UsageError(
            f"{option}{safe_name(name)} is a pattern for numbered files, which 'depthcli video' "
            "writes; name one file, or a folder"
        )


def _one_file(
    sources: Sequence[Path | None], file: Path, suffixes: Mapping[str, str]
) -> OutputPlan:
    if len(sources) != 1:
        raise UsageError(
            f"-o {file} is one file but there are {len(sources)} inputs; name a folder: {file}/"
        )
    if is_special(file):
        raise UsageError(f"-o {file} is a device or a pipe; '-o -' writes to standard output")
    if len(suffixes) == 1 and format_of(file.name):
        return OutputPlan(sources[0], dict.fromkeys(suffixes, file))
    # Several formats of one input share the stem of the name; a single one adds its suffix.
    return OutputPlan(
        sources[0], {f: file.with_name(stem_of(file.name) + s) for f, s in suffixes.items()}
    )


def _in_folders(
    sources: Sequence[Path | None], out: Path | None, suffixes: Mapping[str, str]
) -> list[OutputPlan]:
    folders = [_output_folder(source, out) for source in sources]
    stems = [
        folder / (s.stem if s else STDIN_STEM) for folder, s in zip(folders, sources, strict=True)
    ]
    bases = output_bases(sources)
    shared = Counter(
        _case_folded_path(stem)
        for source, stem, base in zip(sources, stems, bases, strict=True)
        if source is None or base == source.stem or not is_exr(source.name)
    )
    plans = []
    for source, folder, stem, base in zip(sources, folders, stems, bases, strict=True):
        is_whole = (
            source is not None and shared[_case_folded_path(stem)] > 1 and base == source.stem
        )
        name = source.name if source and is_whole else base
        wanted = {} if source and not source.name else suffixes
        plans.append(OutputPlan(source, {f: folder / (name + s) for f, s in wanted.items()}))
    return plans


def _output_folder(source: Path | None, out: Path | None) -> Path:
    """The folder for an input's outputs."""
    if out is not None:
        return out
    return Path() if source is None else source.parent


def output_bases(sources: Sequence[Path | None]) -> list[str]:
    """The names of each input's outputs, without suffix; None is standard input.

    An EXR gives way to other pictures and videos with its stem. It does not change their names,
    which are those of a batch: that reads no EXR, since many hold depth or other data.
    """
    inside: dict[Path, set[str]] = {}
    for source in sources:
        if source is not None:
            inside.setdefault(source.parent, set()).add(source.name)
    from depthcli.jobs.unique_names import TreeNames  # noqa: PLC0415 - imports NumPy

    bases: dict[tuple[Path, str], str] = {}
    for folder, own in inside.items():
        names = _with_namesakes(folder, own)
        others = {name for name in names if not is_exr(name)}
        for them, among in ((own & others, TreeNames(others)), (own - others, TreeNames(names))):
            bases |= {(folder, name): among.base(name) for name in them}
    return [STDIN_STEM if s is None else bases[s.parent, s.name] for s in sources]


def _with_namesakes(folder: Path, own: set[str]) -> set[str]:
    """Inputs of one folder, and the pictures and videos there whose outputs could collide."""
    others = set(chain(*namesakes(folder, own).values())) - own
    return own | {
        name
        for name in others
        if is_media(name) and not (folder / name).is_dir() and not is_own_picture(folder / name)
    }


def check_collisions(plans: Sequence[OutputPlan]) -> None:
    """Check that no output is an input, or another output.

    Raises:
        UsageError: one is.
    """
    places = RealPaths()
    sources = (plan.source for plan in plans if plan.source is not None)
    inputs = {_case_folded_path(place) for source in sources for place in places.all_of(source)}
    owners: dict[str, Path | None] = {}
    for plan in plans:
        for path in plan.outputs.values():
            check_writable(path)
            place = _case_folded_path(places.of(path))
            if place in inputs:
                raise UsageError(f"{path} is an input; choose another -o")
            if place in owners:
                if places.of(plan.source or "") == places.of(owners[place] or ""):
                    raise UsageError(f"{plan.source} is given twice; give it once")
                raise UsageError(
                    f"{plan.source} and {owners[place]} would both become {path}; "
                    "run them one by one with different -o"
                )
            owners[place] = plan.source


def _case_folded_path(path: str | Path) -> str:
    """The path in the form that case-insensitive file systems compare."""
    return os.path.normcase(os.path.abspath(path)).casefold()  # noqa: PTH100 - links stay as named
