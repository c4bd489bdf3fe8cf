"""Web servers on this machine: of one file that is cut off, and a camera of Motion JPEG."""

import queue
import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Self

import cv2
import numpy as np

BOUNDARY = "frame"


def free_port() -> int:
    """A port that no server has."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])


class Server:
    """Answers requests of any method at ``url`` while it is entered."""

    def __init__(self, name: str = "", protocol: str = "HTTP/1.0") -> None:
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = protocol

            def log_message(self, *_: object) -> None:
                pass

            def handle_any(self) -> None:
                outer.answer(self)

            do_GET = do_PUT = do_HEAD = do_POST = do_DELETE = handle_any  # noqa: N815

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.handle_error = lambda *_: None  # of clients that leave
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,))
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/{name}"
        self.stopped = threading.Event()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        raise NotImplementedError

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stopped.set()
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


class FileServer(Server):
    """Serves ``data``.

    Attributes:
        data: the file; another one may be put in its place.
        cut_after: bytes after which an answer is cut off; None for whole answers.
        has_ranges: whether it can begin in the middle of the file.
        starts: first byte of each answer.
        tokens: the header Authorization of each request; None without one.
        shift: bytes by which a part begins after what was asked for.
    """

    def __init__(self, data: bytes) -> None:
        super().__init__("model.onnx")
        self.data, self.has_ranges, self.starts = data, True, list[int]()
        self.cut_after: int | None = None
        self.shift, self.tokens = 0, list[str | None]()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        asked = request.headers.get("Range") if self.has_ranges else None
        start = int(asked.removeprefix("bytes=").partition("-")[0]) if asked else 0
        self.starts.append(start)
        self.tokens.append(request.headers.get("Authorization"))
        rest = self.data[start:]
        request.send_response(206 if asked else 200)
        request.send_header("Content-Length", str(len(rest)))
        if asked:
            place = f"bytes {start + self.shift}-{len(self.data) - 1}/{len(self.data)}"
            request.send_header("Content-Range", place)
        request.end_headers()
        request.wfile.write(rest[: self.cut_after])


class Camera(Server):
    """Sends gray frames of 64×48 pixels, by default 50 a second.

    Attributes:
        connections: how often it was connected to.
        levels: brightness of frames to send; None ends the connection.
    """

    def __init__(self, *, is_endless: bool = True) -> None:
        """Prepare; with ``is_endless``, frames of level 100 are sent when there are no others."""
        super().__init__("video.mjpg")
        self.connections, self.is_endless = 0, is_endless
        self.levels: queue.Queue[int | None] = queue.Queue()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        self.connections += 1
        request.send_response(200)
        kind = f"multipart/x-mixed-replace; boundary={BOUNDARY}"
        request.send_header("Content-Type", kind)
        request.end_headers()
        while (level := self._next_level()) is not None:
            request.wfile.write(part(level))

    def _next_level(self) -> int | None:
        while not self.stopped.is_set():
            try:
                return self.levels.get(timeout=0.02)
            except queue.Empty:
                if self.is_endless:
                    return 100
        return None


def part(level: int) -> bytes:
    """One frame of the answer of a camera."""
    jpeg = cv2.imencode(".jpg", np.full((48, 64, 3), level, np.uint8))[1].tobytes()
    head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
    return head.encode() + jpeg + b"\r\n"
