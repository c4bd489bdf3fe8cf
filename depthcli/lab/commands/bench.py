"""``depthcli bench``: speed of a model on this machine."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import typer

from depthcli.cli import options, parse
from depthcli.cli.screen import console
from depthcli.core.options import Upsampling
from depthcli.errors import ExitCode

_MEASUREMENTS = 3  # network, end to end, throughput


def bench(
    image: Path | None = typer.Argument(
        None, metavar="[IMG]", help="Input image. Default: a synthetic one."
    ),
    size: str = typer.Option(
        "640x480", metavar="WxH", help="Size of the synthetic image in pixels."
    ),
    *,
    model: options.ModelOptions,
    workers: options.WorkersOption = None,
    upsample: options.UpsampleOption = Upsampling.GUIDED,
    seconds: float = typer.Option(
        3.0,
        min=0,
        max=3600,
        callback=options.not_negative,
        help="Duration of each measurement in seconds.",
    ),
    as_json: options.JsonOption = False,
) -> int:
    """Measure network latency, end-to-end latency, throughput and peak memory.

    End-to-end is from the encoded file to a 16-bit PNG on disk.
    """
    from depthcli.lab.jobs.bench import run_bench

    loader, size_px = parse.session_loader(model.model, model.runtime), parse.size(size)
    if sys.stderr.isatty() and not as_json:
        console.note(f"measuring for about {_MEASUREMENTS * seconds:.0f} s")
    done = run_bench(loader, size_px, seconds, image, upsample, workers, console.warn)
    lines = [f"{done.model} on {done.provider}"]
    for name, time in (("network", done.network), ("end-to-end", done.end_to_end)):
        spread = f"minimum {time.min_ms:.2f} ms, noise ±{time.noise:.0%}, {time.runs} runs"
        lines.append(f"{name:<14} {time.median_ms:8.2f} ms  ({spread})")
    lines.append(f"throughput     {done.images_per_s:8.1f} images/s, {done.workers} at a time")
    if done.peak_memory_mb is not None:
        lines.append(f"peak memory    {done.peak_memory_mb:8.0f} MB")
    console.show(dataclasses.asdict(done), *lines, as_json=as_json)
    return ExitCode.OK
