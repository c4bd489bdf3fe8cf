"""What ``depthcli batch --dry-run`` says: what a batch would do, without a trace."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.core.text import one_line
from depthcli.errors import ExitCode, InputError
from depthcli.io.listing.folder import is_video
from depthcli.io.listing.skipped import summary
from depthcli.io.pictures.decode import check
from depthcli.jobs.batch.journal import known_rows
from depthcli.jobs.batch.pictures import read_input
from depthcli.jobs.batch.recipe import Targets
from depthcli.jobs.batch.videos import checked_video

if TYPE_CHECKING:
    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.listing.folder import Found
    from depthcli.jobs.batch.plan import Plan
    from depthcli.jobs.batch.recipe import Recipe


def dry_run(plan: Plan, recipe: Recipe, pipeline: Pipeline, *, as_json: bool) -> int:
    """Say what would become of each input. Inputs are read and outputs are checked.

    Returns:
        The exit code.
    """
    targets = Targets(plan, recipe, recipe.origin(pipeline), known_rows(plan.out))
    targets.check_apart()
    for warning in plan.warnings:
        console.warn(warning)
    counts = {"do": 0, "keep": 0, "fail": 0}
    for found in plan.inputs:
        what, problem = _verdict(targets, found)
        counts[what] += 1
        paths = [str(path) for path in targets.of(found).values()]
        _tell(what, found.name, paths, problem, as_json=as_json)
    for file in plan.skipped:
        _tell("skip", file.name, [], file.reason, as_json=as_json)
    rest = f"; {summary(plan.skipped)}" if plan.skipped else ""
    console.note(
        f"would process {counts['do']}, keep {counts['keep']} already done, fail "
        f"{counts['fail']}{rest}"
    )
    return ExitCode.OK


def _tell(what: str, name: str, outputs: list[str], problem: str | None, *, as_json: bool) -> None:
    if as_json:
        console.out_json({"input": name, "would": what, "outputs": outputs, "error": problem})
    else:
        target = problem or ", ".join(outputs)
        console.out(one_line(f"{what:<4}  {name} -> {target}"))


def _verdict(targets: Targets, found: Found) -> tuple[str, str | None]:
    try:
        if is_video(found.name):
            sha256 = checked_video(found, targets)
        else:
            data = read_input(found)
            check(data, found.path, targets.recipe.limit)
            sha256 = hashlib.sha256(data).hexdigest()
    except InputError as error:
        return "fail", str(error)
    return ("keep" if targets.kept(found, sha256) else "do"), None
