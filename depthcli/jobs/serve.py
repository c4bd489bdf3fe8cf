"""A server on HTTP with one loaded model: images in, depth out.

No path of a client is opened: an image comes in the body of a request, its options in the query.
"""

import asyncio
import hmac
import json
import logging
import mimetypes
import socket
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from http.client import responses
from importlib.resources import files
from io import BytesIO
from pathlib import PurePath
from typing import Any

import uvicorn
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Gauge, Histogram
from prometheus_client.exposition import generate_latest
from starlette.applications import Starlette
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive
from uvicorn.protocols.http.auto import AutoHTTPProtocol

from depthcli import errors
from depthcli._version import __version__
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.io.formats.table import Format
from depthcli.io.storage.atomic import temporary_folder
from depthcli.jobs.image import ImageJob, ImageTask, depth_facts
from depthcli.jobs.outputs import MapOptions

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_DRAIN_S = 30
IDLE_S = 75  #: after which silent connections end; nginx and AWS use theirs again for 60 s
_MOST_PARSED = 256
_RETRY = {"Retry-After": "1"}
_PROBLEM = "application/problem+json"
_FILES = files("depthcli.jobs")
mimetypes.add_type("model/vnd.usdz+zip", ".usdz")
_IN_FLIGHT = "depthcli_in_flight"
_IMAGE_FIELDS, _KNOWN = ("image", "file"), "anchors"  # of a form
_OF_SERVER = {"max_pixels": "the server's --max-pixels"}  #: parameters that no request has


@dataclass(frozen=True, slots=True)
class Asked(MapOptions):
    """Options of one request, whose anchors are points."""

    format: Format = Format.PNG16


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a server."""

    workers: int  #: images processed at a time
    queue: int  #: further requests that wait; more are answered with 429
    timeout_s: float  #: for one image, with its time in the queue; then the answer is 503
    max_bytes: int  #: of a request's body
    max_pixels: int  #: of an image


class _Connection(AutoHTTPProtocol):  # type: ignore[misc, valid-type]
    """A connection that ends when no request begins for long, as in a header without end."""

    def connection_made(self, transport: Any) -> None:  # noqa: ANN401 - as asyncio's
        super().connection_made(transport)
        self._check = self.loop.call_later(IDLE_S, self._close_if_idle, None)

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._check.cancel()

    def _close_if_idle(self, earlier: Any) -> None:  # noqa: ANN401 - as uvicorn's
        request = self.cycle
        if request is earlier and (request is None or request.response_complete):
            self.transport.close()
        else:
            self._check = self.loop.call_later(IDLE_S, self._close_if_idle, request)


class DepthServer:
    """The application of a server, for uvicorn or another ASGI server.

    ``parse`` makes the options of a request of the names and values in its query, and of the file
    of known depth that came with it. Requests need the
    token, or, without one, one of ``hosts`` in their header: pages of other sites have neither.
    Browsers let pages of ``origins`` read the answers. ``parameters`` describe the query for
    ``/openapi.json``.
    """

    def __init__(
        self,
        session: Session,
        parse: Callable[[tuple[tuple[str, str], ...], str | None], Asked],
        limits: Limits,
        *,
        token: str | None = None,
        hosts: Sequence[str] = LOOPBACK,
        origins: Sequence[str] = (),
        parameters: Sequence[dict[str, Any]] = (),
    ) -> None:
        self._openapi = json.loads(_FILES.joinpath("openapi.json").read_text("utf-8"))
        self._openapi["info"]["version"] = __version__
        self._openapi["paths"]["/predict"]["post"]["parameters"] = [*parameters]
        self.session, self.limits, self.token = session, limits, token
        self._parse = lru_cache(_MOST_PARSED)(parse)  # clients repeat their options
        self._pool = ThreadPoolExecutor(limits.workers)
        self._metrics = to = CollectorRegistry()
        self._requests = Counter("depthcli_requests", "Requests.", ["status"], registry=to)
        self._seconds = Histogram("depthcli_seconds", "Seconds of an image.", registry=to)
        self._waiting = Gauge(_IN_FLIGHT, "Images in work or waiting.", registry=to)
        # Before 1.7, Starlette cuts hosts at the first colon; no name begins with a bracket.
        allowed = ["*"] if token else [*hosts, "[::1]", "["]
        routes = [
            Route("/", partial(self._page, "serve.html")),
            Route("/docs", partial(self._page, "docs.html")),
            Route("/health", self._health),
            Route("/metrics", self._show_metrics),
            Route("/openapi.json", self._show_openapi),
            Route("/predict", self._predict, methods=["POST"]),
        ]
        self.app: ASGIApp = Starlette(
            routes=routes,
            middleware=[
                Middleware(
                    CORSMiddleware,
                    allow_origins=origins,
                    allow_methods=["POST"],
                    allow_headers=["Authorization"],
                    expose_headers=["Depth-Facts"],
                ),
                Middleware(TrustedHostMiddleware, allowed_hosts=allowed),
            ],
            exception_handlers={HTTPException: self._failed},
        )

    def run(self, host: str, port: int, started: Callable[[str], None]) -> None:
        """Serve until SIGINT or SIGTERM, which lets requests end that have begun.

        Port 0 is any free one; ``started`` is called with the URL, where clients can connect.
        OSError if the port is taken or the host is not of this machine, OutputError if there is no
        temporary folder.
        """
        with temporary_folder():  # each answer is written in one
            pass
        logging.getLogger("uvicorn.access").parent = logging.getLogger("depthcli")
        config = uvicorn.Config(
            self.app,
            host=host,
            port=port,
            log_config=None,
            server_header=False,
            lifespan="off",
            timeout_keep_alive=IDLE_S,
            http=_Connection,
            timeout_graceful_shutdown=_DRAIN_S,
        )
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listening = socket.create_server((host, port), family=family, backlog=config.backlog)
        name = f"[{host}]" if ":" in host else host
        started(f"http://{name}:{listening.getsockname()[1]}")
        uvicorn.Server(config).run(sockets=[listening])

    async def _page(self, name: str, _: Request) -> Response:
        return HTMLResponse(_FILES.joinpath(name).read_text("utf-8"))

    async def _health(self, _: Request) -> Response:
        card = self.session.model.card
        model = {"name": card.name, "version": card.version, "provider": self.session.provider}
        return JSONResponse({"status": "ok", "model": model, "in_flight": self._in_flight()})

    async def _show_openapi(self, _: Request) -> Response:
        return JSONResponse(self._openapi)

    async def _show_metrics(self, request: Request) -> Response:
        self._check_token(request)
        return Response(generate_latest(self._metrics), media_type=CONTENT_TYPE_LATEST)

    async def _predict(self, request: Request) -> Response:
        self._check_token(request)
        query = tuple(request.query_params.multi_items())
        try:
            sent = await self._sent(request)
        except ClientDisconnect as error:
            raise HTTPException(499, "the client has left") from error
        except OSError as error:  # Starlette keeps forms of over 1 MB in a temporary file
            raise HTTPException(500, f"cannot write a temporary file: {error.strerror}") from error
        if self._in_flight() >= self.limits.workers + self.limits.queue:
            raise HTTPException(429, "all workers are busy", _RETRY)
        self._waiting.inc()
        work = self._pool.submit(self._answer, query, sent)
        work.add_done_callback(lambda _: self._waiting.dec())  # after a timeout, work goes on
        start = time.perf_counter()
        try:
            answer = await asyncio.wait_for(asyncio.wrap_future(work), self.limits.timeout_s)
        except TimeoutError:
            raise HTTPException(503, f"not done in {self.limits.timeout_s:g} s", _RETRY) from None
        except (errors.InputError, errors.OutputError, errors.UsageError) as error:
            is_ours = isinstance(error, errors.OutputError) and isinstance(error.__cause__, OSError)
            text = _named_as_in_query(error.message)
            status = 400 if isinstance(error, errors.UsageError) else 500 if is_ours else 422
            raise HTTPException(status, text) from error
        except Exception as error:
            if errors.is_out_of_memory(error):
                raise HTTPException(503, "out of memory; send a smaller image") from error
            reason = str(error) if isinstance(error, errors.DepthcliError) else type(error).__name__
            raise HTTPException(500, reason) from error
        self._seconds.observe(time.perf_counter() - start)
        self._requests.labels(200).inc()
        return answer

    async def _sent(self, request: Request) -> list[tuple[str, bytes]]:
        """Name and bytes of an image, the whole body or a part of a form, and of known depth."""
        request = type(request)(request.scope, _limited(request.receive, self.limits.max_bytes))
        if "multipart/form-data" not in request.headers.get("content-type", ""):
            return [("", await request.body())]
        async with request.form(max_files=2) as form:
            images = [part for name in _IMAGE_FIELDS for part in form.getlist(name)]
            known = form.getlist(_KNOWN)
            parts = [part for part in (*images, *known) if isinstance(part, UploadFile)]
            if len(images) != 1 or len(known) > 1 or len(parts) < len(form):
                problem = "the form is not one file named 'image' or 'file', and at most one "
                raise HTTPException(400, f"{problem}named '{_KNOWN}'; options are in the query")
            return [(part.filename or "", await part.read()) for part in parts]

    def _answer(
        self, query: tuple[tuple[str, str], ...], sent: Sequence[tuple[str, bytes]]
    ) -> Response:
        """The encoded depth of an image and what is known of it; runs in a thread."""
        (_, image), *others = sent
        with temporary_folder() as folder:
            known_depth = None
            for name, data in others:  # at most one, of which only the kind is the client's
                path = folder / (_KNOWN + "".join(PurePath(name).suffixes[-2:]).lower())
                path.write_bytes(data)
                known_depth = str(path)
            options = self._parse(query, known_depth)
            limited = replace(options, max_pixels=self.limits.max_pixels)
            frame, points = limited.read(None, image, "the request"), options.known_points()
        job, body = ImageJob(Pipeline(self.session, options.detail), options.writing), BytesIO()
        done = job.run(ImageTask(frame, options.camera, points, {options.format: body}))
        warnings = map(_named_as_in_query, (*self.session.warnings, *done.warnings))
        facts = depth_facts(done.depth) | {"warnings": [*dict.fromkeys(warnings)]}
        kind = mimetypes.guess_type(f"depth{options.format.facts.suffix}")[0]
        return Response(body.getvalue(), 200, _headers(facts), kind or "application/octet-stream")

    def _in_flight(self) -> int:
        return int(self._metrics.get_sample_value(_IN_FLIGHT) or 0)

    def _check_token(self, request: Request) -> None:
        scheme, _, word = request.headers.get("authorization", "").partition(" ")
        is_right = hmac.compare_digest(word.strip().encode(), str(self.token).encode())
        if self.token and not (scheme.lower() == "bearer" and is_right):
            headers = {"WWW-Authenticate": "Bearer"}
            raise HTTPException(401, "send the header 'Authorization: Bearer TOKEN'", headers)

    async def _failed(self, request: Request, error: Exception) -> Response:
        """One line of text that says what to do, as JSON (RFC 9457) where that is accepted."""
        assert isinstance(error, HTTPException)  # noqa: S101 - it is registered for these
        self._requests.labels(error.status_code).inc()
        if "json" in request.headers.get("accept", ""):
            title = responses.get(error.status_code, "Error")  # 499 is nginx's
            facts = {"title": title, "status": error.status_code}
            facts |= {"type": "about:blank", "detail": error.detail}
            return JSONResponse(facts, error.status_code, error.headers, _PROBLEM)
        return PlainTextResponse(f"{error.detail}\n", error.status_code, error.headers)


def _named_as_in_query(text: str) -> str:
    """A message with the names that parameters have in a query."""
    if not isinstance(text, errors.Message):
        return text
    return text.worded(lambda name: _OF_SERVER.get(name, name))


def _headers(facts: dict[str, Any]) -> dict[str, str]:
    """Facts as headers: numbers and words one by one, all of them as JSON in ``Depth-Facts``."""
    return {
        "Depth-Facts": json.dumps(facts, ensure_ascii=True, allow_nan=False),
        **{
            f"Depth-{name.replace('_', '-').title()}": str(facts[name])
            for name in ("kind", "unit", "min", "median", "max")
            if facts.get(name) is not None
        },
    }


def _limited(receive: Receive, most: int) -> Receive:
    """A receiver that ends a request whose body is larger than ``most`` bytes, or stops."""
    received = 0

    async def limited() -> Message:
        nonlocal received
        try:
            message = await asyncio.wait_for(receive(), IDLE_S)
        except TimeoutError:
            raise HTTPException(408, f"nothing came for {IDLE_S} s") from None
        received += len(message.get("body", b""))
        if received > most:
            raise HTTPException(413, f"the body is larger than {most} bytes")
        return message

    return limited
