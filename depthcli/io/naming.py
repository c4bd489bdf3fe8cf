"""Which output belongs to which input; decided before anything is written."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from depthcli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

STDIN_STEM = "stdin"


class OutputPlan(NamedTuple):
    """The outputs of one input.

    Attributes:
        source: the input; None for standard input.
        outputs: path of each format.
    """

    source: Path | None
    outputs: dict[str, Path]


def plan_outputs(
    sources: Sequence[Path | None], out: str | None, suffixes: Mapping[str, str]
) -> list[OutputPlan]:
    """Name every output.

    Without ``out`` outputs stand beside their input. In one folder, inputs of the same stem keep
    their suffix in the output's name (``a.jpg.depth.png``, ``a.png.depth.png``), so that names do
    not depend on the order of the inputs.

    Args:
        sources: the inputs; None is standard input, whose outputs go to the working directory.
        out: a file (for one input and one format), or a folder: it exists or ends in ``/``.
        suffixes: of each format, as ``.depth.png``.

    Raises:
        UsageError: two inputs share an output, an output is an input, or ``out`` is no folder but
            there are several inputs or formats.
    """
    if out is not None and not is_folder(out):
        plans = [_one_file(sources, Path(out), suffixes)]
    else:
        plans = _in_folders(sources, None if out is None else Path(out), suffixes)
    _check(plans)
    return plans


def is_folder(out: str) -> bool:
    """Whether ``-o`` names a folder: it exists as one, or it ends in a separator."""
    return out.endswith(("/", os.sep)) or Path(out).is_dir()


def _one_file(
    sources: Sequence[Path | None], file: Path, suffixes: Mapping[str, str]
) -> OutputPlan:
    if len(sources) != 1:
        raise UsageError(
            f"-o {file} is one file but there are {len(sources)} inputs; name a folder: {file}/"
        )
    if len(suffixes) == 1:
        return OutputPlan(sources[0], dict.fromkeys(suffixes, file))
    # Several formats of one input share the stem that the user gave.
    return OutputPlan(sources[0], {f: file.with_name(file.stem + s) for f, s in suffixes.items()})


def _in_folders(
    sources: Sequence[Path | None], out: Path | None, suffixes: Mapping[str, str]
) -> list[OutputPlan]:
    stems = [Path(STDIN_STEM) if s is None else (out or s.parent) / s.stem for s in sources]
    if out is not None:
        stems = [out / stem.name for stem in stems]
    shared = Counter(_folded(stem) for stem in stems)
    plans = []
    for source, stem in zip(sources, stems, strict=True):
        shares = shared[_folded(stem)] > 1
        base = source.name if source and shares else stem.name
        plans.append(OutputPlan(source, {f: stem.with_name(base + s) for f, s in suffixes.items()}))
    return plans


def _check(plans: Sequence[OutputPlan]) -> None:
    inputs = {_folded(plan.source) for plan in plans if plan.source is not None}
    owners: dict[str, Path | None] = {}
    for plan in plans:
        for path in plan.outputs.values():
            if _folded(path) in inputs:
                raise UsageError(f"{path} is an input; choose another -o")
            if _folded(path) in owners:
                raise UsageError(
                    f"{plan.source} and {owners[_folded(path)]} would both become {path}; "
                    "run them one by one with different -o"
                )
            owners[_folded(path)] = plan.source


def _folded(path: Path) -> str:
    """Names that a case-insensitive file system takes for one are one."""
    return os.path.normcase(os.path.abspath(path)).casefold()  # noqa: PTH100 - links stay as named
