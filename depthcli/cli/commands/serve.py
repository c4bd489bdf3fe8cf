"""``depthcli serve`` and ``mcp``: the commands, their options, and those of a request."""

from __future__ import annotations

import os
import re
from functools import partial
from typing import TYPE_CHECKING, Any

import typer

from depthcli.cli import groups, options, parse
from depthcli.cli.screen import console
from depthcli.core.options import MAX_PIXELS, Eye
from depthcli.errors import ExitCode, UsageError, os_errors_as
from depthcli.io.formats.table import Format, WriterOptions

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from depthcli.jobs.serve import Asked


_TOKEN = "DEPTHCLI_TOKEN"  # noqa: S105 - the name of a variable
_REFUSED = {"anchors", "extrinsics", "calibration", "rectified", "undistort", "help", "max_pixels"}
"""Options of predict that name a file of the server or belong to one: not for clients."""


@groups.group
class ListenOptions:
    """Options."""

    host: str = options.option("Address to listen on.", default="127.0.0.1")
    port: int = options.option("Port; 0 for any free one.", default=8000, min=0, max=65535)
    token: str | None = options.option(
        f"Token that clients send as 'Authorization: Bearer TOKEN'; needed for other addresses "
        f"than loopback. Default: the variable {_TOKEN}."
    )
    allow_host: list[str] | None = options.option(
        "Further host name by which clients may call a server without a token, such as that of a "
        "proxy; repeatable."
    )
    allow_origin: list[str] | None = options.option(
        "Origin of web pages that may call the server, such as http://localhost:3000; repeatable."
    )
    camera: str | None = options.option(
        "Calibrated camera of requests that name no other; see 'depthcli calibrate'.",
        metavar="NAME",
    )


@groups.group
class LimitOptions:
    """Limits."""

    queue: int = options.option(
        "Requests that wait while all workers are busy; more are answered with 429.",
        default=16,
        min=0,
    )
    timeout: float = options.option(
        "Seconds for one image, including its time in the queue.",
        default=30.0,
        callback=options.positive,
    )
    max_bytes: int = options.option(
        "Maximum size of a request in bytes.", default=64 * 2**20, min=1
    )
    max_pixels: int = options.option(
        "Maximum number of pixels of an image.", default=MAX_PIXELS, min=1
    )


def serve(
    *,
    listen: ListenOptions,
    limits: LimitOptions,
    model: options.ModelOptions,
    workers: options.WorkersOption = None,
    quiet: options.QuietOption = False,
) -> int:
    """Serve depth over HTTP with one loaded model, until it is interrupted.

    POST an image to /predict as the body of the request or as 'image' of a form; options of
    'predict' are in the query: /predict?format=exr&focal_px=518.

    GET /health, /metrics (Prometheus) and / (a page to drop an image on). No option of a request
    names a file, and no path is opened.
    """
    from depthcli.core.parallel import share_cores
    from depthcli.jobs.serve import LOOPBACK, DepthServer, Limits

    token = listen.token or os.environ.get(_TOKEN)
    if listen.host not in LOOPBACK and not token:
        raise UsageError(f"{listen.host} can be reached from other machines", "give a {token}")
    count, threads = share_cores(workers, model.runtime.threads)
    parse_request((), camera=listen.camera)
    server = DepthServer(
        parse.session_loader(model.model, model.runtime, threads).load(),
        partial(parse_request, camera=listen.camera),
        Limits(count, limits.queue, limits.timeout, limits.max_bytes, limits.max_pixels),
        token=token,
        hosts=(*LOOPBACK, *(listen.allow_host or ())),
        origins=listen.allow_origin or (),
        parameters=query_parameters(),
    )
    if not quiet:
        console.warn_all(server.session.warnings)
    problem = f"cannot listen at {listen.host}:{listen.port}"
    with os_errors_as(UsageError, problem, "choose another {port} or {host}"):
        server.run(listen.host, listen.port, console.note if not quiet else lambda _url: None)
    return ExitCode.OK


def mcp(*, model: options.ModelOptions) -> int:
    """Serve tools for agents on standard input and output (Model Context Protocol).

    Tools: estimate_depth of an image file, distance at a pixel or in a box of a depth file, view in
    three dimensions. Add 'depthcli mcp' to the configuration of your agent.
    """
    from depthcli.jobs.agent import make_server

    make_server(parse.session_loader(model.model, model.runtime)).run("stdio")
    return ExitCode.OK


def _options(
    *,
    format_: Format = typer.Option(Format.PNG16, "--format", help="Format of the answer."),
    camera: options.CameraOptions,
    anchors: options.FitOptions,
    read: options.ImageOptions,
    detail: options.MapOptions,
    writing: WriterOptions,
    eye: Eye | None = typer.Option(None, help="View of a JPEG with one for each eye."),
) -> Any:  # noqa: ANN401 - Asked
    """Options of a request."""
    from depthcli.jobs.serve import Asked

    return Asked(
        format=format_, **parse.map_options(camera, anchors, read, detail, writing, eye=eye)
    )


_command = groups.command_of(_options)


def parse_request(
    query: Sequence[tuple[str, str]], anchors: str | None = None, camera: str | None = None
) -> Asked:
    """Options of a request by the names of ``predict``, such as ``focal_px``.

    ``anchors`` is the path of the file of known depth that came with it, ``camera`` the name of a
    calibrated one for requests that name none.
    """
    if camera is not None and "camera" not in dict(query):
        query = (*query, ("camera", camera))
    words = [*_words(query), *([f"--anchors={anchors}"] if anchors else [])]
    try:
        request: Asked = _command.main(words, prog_name="/predict", standalone_mode=False)
    except Exception as error:
        if hasattr(error, "format_message"):  # typer's own errors, all about usage
            raise UsageError(error.format_message().strip().replace("--", "")) from error
        raise
    return request


def _parameters() -> dict[str, Any]:
    """The options of a request, by their names in a query."""
    return {
        parameter.opts[-1].removeprefix("--").replace("-", "_"): parameter
        for parameter in _command.params
        if parameter.name not in _REFUSED
    }


def query_parameters() -> list[dict[str, Any]]:
    """The options of a request as OpenAPI describes parameters of a query."""
    types = {"int": "integer", "integer": "integer", "float": "number", "boolean": "boolean"}
    described = []
    for name, parameter in _parameters().items():
        kind = parameter.type
        schema: dict[str, Any] = {"type": types.get(kind.name.split()[0], "string")}
        ends = {"minimum": getattr(kind, "min", None), "maximum": getattr(kind, "max", None)}
        schema |= {end: value for end, value in ends.items() if value is not None}
        if choices := getattr(kind, "choices", None):
            schema["enum"] = [str(choice) for choice in choices]
        if parameter.multiple:
            schema = {"type": "array", "items": schema}
        elif parameter.default is not None and not callable(parameter.default):
            schema["default"] = parameter.default
        text = re.sub("--([a-z0-9-]+)", lambda m: m[1].replace("-", "_"), parameter.help or "")
        described.append({"name": name, "in": "query", "description": text, "schema": schema})
    return described


def _words(query: Sequence[tuple[str, str]]) -> Iterator[str]:
    parameters = _parameters()
    for name, value in query:
        parameter = parameters.get(name.replace("-", "_"))
        if parameter is None:
            names = ", ".join(sorted(parameters))
            raise UsageError(f"no option named {name!r}: there are {names}")
        option = parameter.opts[-1]
        if not getattr(parameter, "is_flag", False):
            yield f"{option}={value}"
        elif value in {"1", "true"}:
            yield option
        elif value not in {"0", "false"}:
            raise UsageError(f"{name} is 1 or 0, not {value!r}")
