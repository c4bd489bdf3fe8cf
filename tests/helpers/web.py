"""A web server on this machine that keeps one file, and is cut off when a test wants it."""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Self


class FileServer:
    """Serves ``data`` at ``url``.

    Attributes:
        data: the file; another one may be put in its place.
        cut_after: bytes after which an answer is cut off; None for whole answers.
        has_ranges: whether it can begin in the middle of the file.
        starts: first byte of each answer.
    """

    def __init__(self, data: bytes) -> None:
        self.data, self.cut_after, self.has_ranges = data, None, True
        self.starts: list[int] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def log_message(self, *_: object) -> None:
                pass

            def do_GET(self) -> None:
                outer._answer(self)

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,))
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/model.onnx"

    cut_after: int | None

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def _answer(self, request: BaseHTTPRequestHandler) -> None:
        asked = request.headers.get("Range") if self.has_ranges else None
        start = int(asked.removeprefix("bytes=").partition("-")[0]) if asked else 0
        self.starts.append(start)
        rest = self.data[start:]
        request.send_response(206 if asked else 200)
        request.send_header("Content-Length", str(len(rest)))
        request.end_headers()
        request.wfile.write(rest[: self.cut_after])
