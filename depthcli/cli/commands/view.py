"""``depthcli view``: a page that shows a depth file in three dimensions."""

import typer

from depthcli.cli import options as groups
from depthcli.errors import ExitCode
from depthcli.io.formats.table import Format, SurfaceOptions, WriterOptions, stem_of


def view(
    file: groups.FileArgument,
    image: str | None = typer.Argument(
        None, metavar="[IMAGE]", help="Image of FILE, for colours (else a preview's) and camera."
    ),
    *,
    out: str | None = typer.Option(
        None, "-o", "--out", metavar="OUT", help="Output .html file. Default: next to FILE."
    ),
    is_opened: bool = typer.Option(False, "--open", help="Open the page in the browser."),
    overwrite: groups.OverwriteOption = False,
    depth_file: groups.DepthFileOptions,
    surface: SurfaceOptions,
    camera: groups.StatedCameraOptions,
    read: groups.ReadOptions,
    screen: groups.ScreenOptions,
) -> int:
    """Show a depth file in three dimensions.

    Writes a page, which needs no network, with a grid in metres, the depth at the pointer, and the
    distance between two points.

    Exit codes: 0 success, 1 the file cannot be shown, 2 usage error.
    """
    from dataclasses import asdict

    from depthcli.cli import parse
    from depthcli.cli.screen import console
    from depthcli.cli.screen.results import print_conversion
    from depthcli.io.storage.paths import path_of
    from depthcli.jobs.convert import ConvertRequest, convert

    place = path_of(file)
    seen_by = parse.camera(camera)
    request = ConvertRequest(
        source=file,
        target=out or str(place.with_name(stem_of(place.name) + Format.HTML.facts.suffix)),
        format=Format.HTML,
        stated=parse.depth_reading(depth_file, seen_by),
        camera=seen_by,
        reading=parse.reading(read),
        image=image,
        writing=WriterOptions(**asdict(surface)),
        overwrite=overwrite,
    )
    screen.warn_all(seen_by.warnings)
    result = convert(request)
    print_conversion(result, screen)
    if is_opened:
        import webbrowser

        if not webbrowser.open(path_of(result.target).resolve().as_uri()):
            console.warn(f"no browser was found; open {result.target} in one")
    return ExitCode.OK
