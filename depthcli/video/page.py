"""A page on this machine that shows the newest preview while a video is processed."""

import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Self, cast

import cv2

from depthcli.errors import UsageError, os_errors_as
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.video.outputs import DepthFrame, VideoOutput

_HOSTS = ("127.0.0.1", "localhost")  # a web page that wants to read it comes by another name
_INTERVAL_S = 0.1
_TYPES = {"/": "text/html", "/stream": "multipart/x-mixed-replace; boundary=frame"}
_PAGE = b"""<!doctype html><title>depthcli</title>
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
        self._writer = cast("PreviewWriter", options.writer(Format.PREVIEW))
        self._changed = threading.Condition()
        self._newest: DepthFrame | None = None
        self._count, self._is_over = 0, False
        handler = type("Handler", (_Handler,), {"page": self})
        problem = f"cannot listen at {_HOSTS[0]}:{port}"
        with os_errors_as(UsageError, problem, "choose another port", option="show"):
            self._server = ThreadingHTTPServer((_HOSTS[0], port), handler)
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()

    def __enter__(self) -> Self:
        self.callback(self._end)
        return self

    def _end(self) -> None:
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        self._server.shutdown()
        self._server.server_close()

    def encode(self, frame: DepthFrame) -> DepthFrame:
        """The frame itself, which is drawn when someone looks."""
        return frame

    def append(self, encoded: DepthFrame) -> None:
        """Replace the newest frame."""
        with self._changed:
            self._newest, self._count = encoded, self._count + 1
            self._changed.notify_all()

    def jpeg_after(self, count: int) -> tuple[int, bytes] | None:
        """Wait for a frame after the one with this number; None if the video ends before."""
        with self._changed:
            self._changed.wait_for(lambda: self._count > count or self._is_over)
            frame, number = self._newest, self._count
        if frame is None or number == count:
            return None
        pixels = self._writer.render(frame.depth, frame.image, frame.spread)
        return number, cv2.imencode(".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))[1].tobytes()


class _Handler(BaseHTTPRequestHandler):
    page: PreviewPage
    timeout = 10  # seconds in which a client has to read

    def log_message(self, *_: object) -> None:
        pass

    def do_GET(self) -> None:
        if self.headers.get("Host", "").partition(":")[0] not in _HOSTS or self.path not in _TYPES:
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Type", _TYPES[self.path])
        self.end_headers()
        if self.path == "/":
            self.wfile.write(_PAGE)
            return
        count, boundary = 0, b"--frame\r\n"  # which tells browsers that the part before is whole
        with suppress(OSError):  # nobody looks any more
            self.wfile.write(boundary)
            while found := self.page.jpeg_after(count):
                count, jpeg = found
                head = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                self.wfile.write(head.encode() + jpeg + b"\r\n" + boundary)
                time.sleep(_INTERVAL_S)
