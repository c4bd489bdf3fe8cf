"""Tools of depth for agents, by the Model Context Protocol (https://modelcontextprotocol.io).

The server speaks on standard input and output, so that nothing else may be printed there. A tool
that fails answers with the error's line, which says what to do.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mcp.server import MCPServer
from mcp.server.mcpserver.exceptions import ToolError

from depthcli._version import __version__
from depthcli.core.camera import Intrinsics
from depthcli.errors import DepthcliError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format
from depthcli.jobs import inspect, outputs
from depthcli.jobs.convert import ConvertRequest, convert
from depthcli.jobs.image import FailedInput, depth_facts
from depthcli.jobs.predict import PredictRequest, image_destination, predict

_GUIDE = (
    "Depth in metres from single images of rooms. Estimate the depth of an image first, then ask "
    "for distances and places in its depth file."
)


@contextmanager
def _answered() -> Iterator[None]:
    """Make errors of depthcli the answer of a tool; the SDK hides what others say."""
    try:
        yield
    except DepthcliError as error:
        raise ToolError(str(error)) from error


def make_server(model: SessionLoader) -> MCPServer:
    """A server of three tools, of which one runs a model."""
    server = MCPServer("depthcli", version=__version__, instructions=_GUIDE, log_level="ERROR")

    @server.tool()
    @_answered()
    def estimate_depth(image: str, out: str, hfov_deg: float | None = None) -> dict[str, Any]:
        """Estimate the depth of an image, and write it to a file: .png (16-bit, millimetres), .exr
        or .npy (metres), .glb (mesh), .html (a page in three dimensions).

        hfov_deg is the horizontal field of view of the camera, if it is known.
        """  # noqa: D205 - the protocol shows all of it
        if out == outputs.STDIO:
            raise UsageError("standard output is the protocol's; name a file")
        camera = Intrinsics(hfov_deg=hfov_deg)
        request = PredictRequest(
            images=(image,), destination=image_destination(out), model=model, camera=camera
        )
        (done,) = predict(request)
        if isinstance(done, FailedInput):
            raise done.error
        facts = depth_facts(done.depth)
        return {"files": done.outputs, **facts, "warnings": [*map(str, done.warnings)]}

    @server.tool()
    @_answered()
    def distance(depth_file: str, place: list[int]) -> dict[str, Any]:
        """Depth at a pixel [x, y] of a depth file, with its point in space and its surface's
        normal; or in a box [left, top, right, bottom], with its width and height in metres.
        """  # noqa: D205
        stored = inspect.read_map(Path(depth_file))
        depth = stored.displayed
        match place:
            case [left, top, right, bottom] if min(place) >= 0:
                facts = asdict(inspect.depth_in(depth, (left, top, right, bottom)))
            case [x, y] if min(place) >= 0:
                facts = asdict(inspect.depth_at(depth, x, y))
            case _:
                raise UsageError(f"{place} is neither [x, y] nor [left, top, right, bottom]")
        return {"unit": depth.unit, **facts, "warnings": [*stored.warnings]}

    @server.tool()
    @_answered()
    def view(depth_file: str, image: str, out: str) -> dict[str, Any]:
        """Write a page (.html) that shows a depth file with its image in three dimensions."""
        done = convert(ConvertRequest(depth_file, out, Format.HTML, image=image))
        return {"file": done.target, "warnings": [*map(str, done.warnings)]}

    return server
