"""A camera on this machine: Motion JPEG over HTTP, whose frames are sent when a test wants it."""

import queue
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np

BOUNDARY = "frame"


class Camera:
    """Sends gray frames of 64×48 pixels at ``url``, by default 50 a second.

    Attributes:
        connections: how often it was connected to.
        levels: brightness of frames to send; None ends the connection.
    """

    def __init__(self, *, is_endless: bool = True) -> None:
        """Prepare; with ``is_endless``, frames of level 100 are sent when there are no others."""
        self.connections, self.is_endless = 0, is_endless
        self.levels: queue.Queue[int | None] = queue.Queue()
        self._stopped = threading.Event()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def log_message(self, *_: object) -> None:
                pass

            def do_GET(self) -> None:
                outer._answer(self)

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,))
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/video.mjpg"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._stopped.set()
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def _answer(self, request: BaseHTTPRequestHandler) -> None:
        self.connections += 1
        request.send_response(200)
        kind = f"multipart/x-mixed-replace; boundary={BOUNDARY}"
        request.send_header("Content-Type", kind)
        request.end_headers()
        try:
            while (level := self._next_level()) is not None:
                request.wfile.write(part(level))
        except OSError:  # nobody reads it any more
            pass

    def _next_level(self) -> int | None:
        while not self._stopped.is_set():
            try:
                return self.levels.get(timeout=0.02)
            except queue.Empty:
                if self.is_endless:
                    return 100
        return None


def part(level: int) -> bytes:
    """One frame of the answer."""
    pixels: np.ndarray[Any, Any] = np.full((48, 64, 3), level, np.uint8)
    jpeg = cv2.imencode(".jpg", pixels)[1].tobytes()
    head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
    return head.encode() + jpeg + b"\r\n"
