"""``depthcli render``: rendering training data."""

from pathlib import Path

import typer

from depthcli.cli.options import MAX_THREADS, ScreenOptions
from depthcli.core.options import Sensor
from depthcli.errors import ExitCode


def rooms(
    out: Path = typer.Option(
        ...,
        "-o",
        "--out",
        metavar="DIR",
        help="Folder for rgb/, depth/ and cameras.csv; existing rooms are kept.",
    ),
    count: int = typer.Option(1000, min=1, help="Total number of rooms."),
    size: str = typer.Option("256x192", metavar="WxH", help="Size of the images."),
    hfov: str = typer.Option(
        "30-110",
        metavar="LOW-HIGH",
        help="Horizontal field of view in degrees: a range, or one value for all cameras.",
    ),
    sensor: Sensor = typer.Option(
        Sensor.NONE, help="none: exact depth. kinect: noise, holes and frayed edges."
    ),
    seed: int = typer.Option(0, min=0, help="Random seed."),
    workers: int | None = typer.Option(
        None, min=1, max=MAX_THREADS, help="Number of processes. Default: one per core."
    ),
    *,
    screen: ScreenOptions,
) -> int:
    """Render images of furnished rooms with exact depth.

    'depthcli train' reads them with --data or --pseudo-labels.

    The same seed and options give the same files, independent of --count and --workers. Run the
    same command again to resume.
    """
    from depthcli.cli import parse
    from depthcli.cli.screen import console
    from depthcli.cli.screen.progress import show_progress
    from depthcli.core.parallel import share_cores
    from depthcli.datasets.rooms.render import RoomSettings
    from depthcli.jobs.render import render

    settings = RoomSettings(seed, parse.size(size), parse.hfov_range(hfov), sensor)
    with show_progress(silent=screen.quiet or screen.as_json) as progress:
        rendered = render(out, count, settings, share_cores(workers)[0], progress)
    if screen.as_json:
        console.out_json({"out": str(out), "rooms": count, "rendered": rendered})
    elif not screen.quiet:
        console.out(f"{out}: {count} rooms, {rendered} rendered now")
    return ExitCode.OK


COMMANDS = {"rooms": rooms}
