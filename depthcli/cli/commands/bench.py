"""``depthcli bench``: how fast a model is on this machine."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path  # noqa: TC003 - typer reads the annotation
from typing import TYPE_CHECKING, Annotated, Any

import typer

from depthcli.cli.arguments import options
from depthcli.cli.screen import console
from depthcli.core.choices import Upsampling
from depthcli.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from depthcli.inference.pipeline import Pipeline
    from depthcli.jobs.bench import Latency, Speed

app = typer.Typer(rich_markup_mode=None)

_LARGEST_PX = 20_000
_MEASUREMENTS = 3  # network, whole picture, throughput


@app.command()
def bench(
    image: Annotated[
        Path | None,
        typer.Argument(metavar="[IMG]", help="Input picture. Default: a synthetic one."),
    ] = None,
    size: Annotated[
        str, typer.Option(metavar="WxH", help="Size of the synthetic picture in pixels.")
    ] = "640x480",
    model: options.ModelOption = None,
    provider: options.ProviderOption = "auto",
    provider_option: options.ProviderSettingsOption = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Inference threads for the latency measurement.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Pictures processed in parallel for the throughput measurement. Default: one "
            "per core.",
        ),
    ] = None,
    upsample: options.UpsampleOption = Upsampling.GUIDED,
    seconds: Annotated[
        float, typer.Option(min=0, help="Duration of each measurement in seconds.")
    ] = 3.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Measure network latency, end-to-end latency, throughput and peak memory.

    End-to-end is from the encoded file to a 16-bit PNG on disk.
    """
    from depthcli.cli.arguments.provider import session_loader
    from depthcli.core.choices import Detail
    from depthcli.core.parallel.cores import usable_cores
    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.pictures.decode import read_bytes
    from depthcli.jobs.bench import made_picture, measure_speed

    data = read_bytes(image) if image else made_picture(*_pixels(size))
    count = workers or usable_cores()
    each = max(1, usable_cores() // count)
    alone, shared = (
        Pipeline(session_loader(model, provider, n, provider_option).load(), Detail(upsample))
        for n in (threads, each)
    )
    for warning in alone.session.warnings:
        console.warn(warning)
    if sys.stderr.isatty() and not as_json:
        console.note(f"measuring for about {_MEASUREMENTS * seconds:.0f} s")
    speed = measure_speed(alone, shared, data, workers=count, seconds=seconds)
    if as_json:
        console.out_json(_facts(alone, count) | dataclasses.asdict(speed))
    else:
        _tell(alone, speed, count)
    return ExitCode.OK


def _pixels(size: str) -> tuple[int, int]:
    width, _, height = size.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise UsageError(f"--size {size!r} is not WIDTHxHEIGHT; for example 640x480")
    if not (0 < int(width) <= _LARGEST_PX and 0 < int(height) <= _LARGEST_PX):
        raise UsageError(f"--size {size!r}: each side is 1 to {_LARGEST_PX} pixels")
    return int(width), int(height)


def _facts(pipeline: Pipeline, workers: int) -> dict[str, Any]:
    session = pipeline.session
    return {
        "model": pipeline.card.name,
        "model_sha256": session.model.sha256,
        "provider": session.provider,
        "workers": workers,
    }


def _tell(pipeline: Pipeline, speed: Speed, workers: int) -> None:
    console.out(f"{pipeline.card.name} on {pipeline.session.provider}")
    console.out(f"network        {_latency(speed.network)}")
    console.out(f"whole picture  {_latency(speed.whole)}")
    console.out(f"throughput     {speed.pictures_per_s:8.1f} pictures/s, {workers} at a time")
    if speed.peak_memory_mb is not None:
        console.out(f"peak memory    {speed.peak_memory_mb:8.0f} MiB")


def _latency(latency: Latency) -> str:
    return (
        f"{latency.median_ms:8.2f} ms  (least {latency.min_ms:.2f}, "
        f"noise ±{latency.noise:.0%}, {latency.runs} runs)"
    )
