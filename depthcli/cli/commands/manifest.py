"""``depthcli manifest``: summing up, searching and merging the manifests of a batch."""

from dataclasses import asdict
from typing import Annotated

import typer

from depthcli.cli.options import JsonOption
from depthcli.cli.screen import console
from depthcli.core.options import one_line
from depthcli.errors import ExitCode
from depthcli.io.manifest import FAILED
from depthcli.io.storage.paths import path_of

_Manifest = Annotated[
    str, typer.Argument(metavar="OUT", help="Output folder of a batch, or a manifest in it.")
]


def show_summary(out: _Manifest, as_json: JsonOption = False) -> int:
    """Count inputs, failures and outputs, of all shards together."""
    from depthcli.jobs.batch.manifests import damage, read_rows, summarize

    sums = summarize(read_rows(path_of(out)))
    if problem := damage(path_of(out)):
        console.warn(problem)
    lines = [f"{sums.inputs} inputs: {sums.inputs - sums.failed} ok, {sums.failed} failed"]
    lines.append(f"{sums.outputs} outputs, {sums.output_bytes / 1e6:.1f} MB")
    lines.append(f"{sums.seconds:.1f} s of processing time")
    for model in sums.models:
        by = "{inputs} by model {model} ({model_sha256:.12}), depthcli {version}"
        lines.append(by.format_map(model))
    console.show(asdict(sums), *lines, as_json=as_json)
    return ExitCode.OK


def list_failed(out: _Manifest, as_json: JsonOption = False) -> int:
    """List the inputs that failed, each with the reason."""
    from depthcli.jobs.batch.manifests import read_rows

    for row in read_rows(path_of(out)):
        if row.status == FAILED and as_json:
            console.out_json(row.as_json())
        elif row.status == FAILED:
            console.out(f"{one_line(row.input)}\t{one_line(row.error or '')}")
    return ExitCode.OK


def merge_parts(
    out: str = typer.Argument(..., metavar="OUT", help="Output folder of a batch."),
    as_json: JsonOption = False,
) -> int:
    """Merge the manifests of all shards into one, and remove them."""
    from depthcli.jobs.batch.manifests import merge_manifests

    path = str(merge_manifests(path_of(out)))
    console.show({"manifest": path}, f"manifest: {path}", as_json=as_json)
    return ExitCode.OK


COMMANDS = {"summary": show_summary, "failed": list_failed, "merge": merge_parts}
