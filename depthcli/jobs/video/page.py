"""A page on this machine that shows the newest preview while a video is processed."""

import socket
import threading
import time
from collections.abc import Iterator
from typing import Self, cast

import cv2
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response, StreamingResponse
from starlette.routing import Route

from depthcli.errors import UsageError, os_errors_as
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.table import Format, WriterOptions, writer_of
from depthcli.video.outputs import DepthFrame, VideoOutput

_HOSTS = ("127.0.0.1", "localhost")  # a web page that wants to read it comes by another name
_INTERVAL_S = 0.1
_PAGE = """<!doctype html><title>depthcli</title>
<style>body{margin:0;background:#111}
img{display:block;width:100%;height:100vh;object-fit:contain}</style>
<img src="/stream" alt="newest preview">"""


class PreviewPage(VideoOutput):
    """Shows previews at ``http://127.0.0.1:PORT/`` until the video ends, at most ten a second.

    They are drawn by the threads of those who look, so that the video does not wait.
    """

    def __init__(self, port: int, options: WriterOptions) -> None:
        """Listen at once; UsageError if the port cannot be had."""
        super().__init__()
        self._writer = cast("PreviewWriter", writer_of(Format.PREVIEW, options))
        self._changed = threading.Condition()
        self._newest: DepthFrame | None = None
        self._count, self._is_over = 0, False
        problem = f"cannot listen at {_HOSTS[0]}:{port}"
        with os_errors_as(UsageError, problem, "choose another port", option="show"):
            listening = socket.create_server((_HOSTS[0], port))
        app = Starlette(
            routes=[Route("/", self._page), Route("/stream", self._stream)],
            middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=_HOSTS)],
        )
        config = uvicorn.Config(app, log_config=None, lifespan="off", timeout_graceful_shutdown=1)
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([listening],), daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        self.callback(self._end)
        return self

    def _end(self) -> None:
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        self._server.should_exit = True
        self._thread.join()

    def encode(self, frame: DepthFrame) -> DepthFrame:
        """The frame itself, which is drawn when someone looks."""
        return frame

    def append(self, encoded: DepthFrame) -> None:
        """Replace the newest frame."""
        with self._changed:
            self._newest, self._count = encoded, self._count + 1
            self._changed.notify_all()

    async def _page(self, _: Request) -> Response:
        return HTMLResponse(_PAGE)

    async def _stream(self, _: Request) -> Response:
        return StreamingResponse(
            self._parts(), media_type="multipart/x-mixed-replace; boundary=frame"
        )

    def _frame_after(self, count: int) -> tuple[int, DepthFrame] | None:
        """Wait for a frame after the one with this number; None if the video ends before."""
        with self._changed:
            self._changed.wait_for(lambda: self._count > count or self._is_over)
            frame, number = self._newest, self._count
        return None if frame is None or number == count else (number, frame)

    def _parts(self) -> Iterator[bytes]:
        """The newest preview as JPEG, and each that follows, until the video ends."""
        count, boundary = 0, b"--frame\r\n"  # which tells browsers that the part before is whole
        yield boundary
        while newest := self._frame_after(count):
            count, frame = newest
            pixels = self._writer.render(frame.depth, frame.image, frame.spread)
            jpeg = cv2.imencode(".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))[1].tobytes()
            head = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            yield head.encode() + jpeg + b"\r\n" + boundary
            time.sleep(_INTERVAL_S)
