"""What an object store costs: listing a million objects, reading and writing.

    python benchmarks/object_store.py [--objects 1000000] [--files 500]

The server is one of this script, in a process of its own on this machine: it makes up the pages of
its list and keeps no object, so that what is measured is the client. Wall times therefore hold for
a store without distance; a real one adds its latency (10 to 50 ms a request), in which other
workers go on.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import deque
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import islice
from typing import TYPE_CHECKING
from urllib.parse import parse_qs

from tools import parse_options, print_cost

from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.paths import RemotePath, read_bytes

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

PAGE, DATA = 1000, bytes(100_000)
ENTRY = (
    "<Contents><Key>{}{:09d}.jpg</Key><LastModified>2025-01-01T00:00:00.000Z</LastModified>"
    "<ETag>&quot;e&quot;</ETag><Size>100000</Size><StorageClass>STANDARD</StorageClass></Contents>"
)


def page(query: str, total: int) -> bytes:
    """A page of the list, made up."""
    words = parse_qs(query)
    begin, prefix = int(words.get("continuation-token", ["0"])[0]), words["prefix"][0]
    end = min(begin + PAGE, total)
    token = f"<NextContinuationToken>{end}</NextContinuationToken>" if end < total else ""
    entries = "".join(ENTRY.format(prefix, number) for number in range(begin, end))
    return (
        f"<ListBucketResult><Name>b</Name><Prefix>{prefix}</Prefix><MaxKeys>{PAGE}</MaxKeys>"
        f"<IsTruncated>{str(bool(token)).lower()}</IsTruncated>{token}{entries}</ListBucketResult>"
    ).encode()


class Store(BaseHTTPRequestHandler):
    """Answers of a store whose objects are all the same."""

    protocol_version = "HTTP/1.1"
    wbufsize = -1
    disable_nagle_algorithm = True
    objects = 0

    def answer(self) -> None:
        """Take what is sent, and send a page of the list or an object."""
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        query = self.path.partition("?")[2]
        is_list = self.command == "GET" and "list-type" in query
        body = page(query, self.objects) if is_list else DATA
        self.send_response(200)
        self.send_header("Content-Length", str(0 if self.command == "PUT" else len(body)))
        self.send_header("ETag", '"e"')
        self.send_header("Last-Modified", "Tue, 21 Oct 2025 07:28:00 GMT")
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body)

    do_GET = do_PUT = do_HEAD = answer  # noqa: N815 - http.server's names

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def serve(port: Connection, objects: int) -> None:
    """Serve until the process is ended."""
    Store.objects = objects
    server = ThreadingHTTPServer(("127.0.0.1", 0), Store)
    port.send(server.server_port)
    server.serve_forever()


def measure_files(folder: RemotePath, count: int) -> None:
    """Write and read small files."""

    def write() -> None:
        for number in range(count):
            with atomic_path(folder / f"{number}.jpg") as temporary:
                temporary.write_bytes(DATA)

    def read() -> None:
        for number in range(count):
            read_bytes(folder / f"{number}.jpg")

    print_cost("write 100 kB", write, count)
    print_cost("read 100 kB", read, count)


def main() -> None:
    """Measure."""
    options = parse_options(__doc__, objects=1_000_000, files=500)
    here, there = multiprocessing.Pipe()
    server = multiprocessing.get_context("spawn").Process(
        target=serve, args=(there, options.objects), daemon=True
    )
    server.start()
    os.environ |= {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{here.recv()}",
        "AWS_ACCESS_KEY_ID": "a",
        "AWS_SECRET_ACCESS_KEY": "b",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    folder = RemotePath("s3://bucket/images")
    read_bytes(folder / "first.jpg")
    measure_files(folder, options.files)
    for share in (100, 10, 1):
        count = options.objects // share
        print_cost("list", partial(deque, islice(folder.walk_names(), count), maxlen=0), count)
    server.kill()


if __name__ == "__main__":
    main()
