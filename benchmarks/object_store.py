"""What an object store costs: listing a million objects, reading and writing against the disk.

    python benchmarks/object_store.py [--objects 1000000] [--files 500]

The server is one of this script, in a process of its own on this machine: it makes up the pages of
its list and keeps no object, so that what is measured is the client. Wall times therefore hold for
a store without distance; a real one adds its latency (10 to 50 ms a request), in which other
workers go on.
"""

from __future__ import annotations

import argparse
import asyncio
import multiprocessing
import os
import re
import resource
import time
from collections import deque
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING
from urllib.parse import parse_qs

from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.paths import RemotePath, read_bytes

if TYPE_CHECKING:
    from collections.abc import Callable
    from multiprocessing.connection import Connection

PAGE, FILE_BYTES = 1000, 100_000
HEADERS = (
    'HTTP/1.1 {}\r\nContent-Length: {}\r\nETag: "e"\r\n'
    "Last-Modified: Tue, 21 Oct 2025 07:28:00 GMT\r\nContent-Type: image/jpeg\r\n\r\n"
)
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


async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, objects: int) -> None:
    """Answer the requests of one connection."""
    body = bytes(FILE_BYTES)
    try:
        while True:
            head = await reader.readuntil(b"\r\n\r\n")
            verb, target, _ = head.split(b"\r\n", 1)[0].decode().split(" ")
            length = re.search(rb"(?i)content-length: (\d+)", head)
            if length:
                await reader.readexactly(int(length[1]))
            listed = verb == "GET" and "list-type" in target
            data = page(target.partition("?")[2], objects) if listed else body
            size = 0 if verb == "PUT" else len(data)
            writer.write(HEADERS.format("200 OK", size).encode())
            writer.write(data if verb == "GET" else b"")
            await writer.drain()
    except (asyncio.IncompleteReadError, ConnectionError):
        writer.close()


def serve(told: Connection, objects: int) -> None:
    """Serve until the process is ended."""

    async def run() -> None:
        server = await asyncio.start_server(
            lambda reader, writer: answer(reader, writer, objects), "127.0.0.1", 0
        )
        told.send(server.sockets[0].getsockname()[1])
        await server.serve_forever()

    asyncio.run(run())


def measured(what: str, count: int, work: Callable[[], object]) -> None:
    """Time of some work, and the memory that the process had at most."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    work()
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    each = f"{1e3 * cpu_s / count:.3f} ms CPU, {1e3 * wall_s / count:.3f} ms wall each"
    print(f"{what}: {count:,} in {wall_s:.1f} s, {each}; peak {peak_mb:.0f} MiB", flush=True)


def measure_files(folder: Path, count: int) -> None:
    """Write and read small files."""
    where = "store" if isinstance(folder, RemotePath) else "disk"
    data = bytes(FILE_BYTES)

    def write() -> None:
        for number in range(count):
            with atomic_path(folder / f"{number}.jpg") as temporary:
                temporary.write_bytes(data)

    def read() -> None:
        for number in range(count):
            read_bytes(folder / f"{number}.jpg")

    measured(f"{where}: write 100 kB", count, write)
    measured(f"{where}: read 100 kB", count, read)


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--objects", type=int, default=1_000_000)
    parser.add_argument("--files", type=int, default=500)
    given = parser.parse_args()
    here, there = multiprocessing.Pipe()
    server = multiprocessing.get_context("spawn").Process(
        target=serve, args=(there, given.objects), daemon=True
    )
    server.start()
    os.environ |= {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{here.recv()}",
        "AWS_ACCESS_KEY_ID": "a",
        "AWS_SECRET_ACCESS_KEY": "b",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    folder = RemotePath("s3://bucket/pictures")
    read_bytes(folder / "first.jpg")
    measure_files(folder, given.files)
    with TemporaryDirectory() as name:
        measure_files(Path(name), given.files)
    for share in (100, 10, 1):
        count = given.objects // share
        names = islice(folder.walk_names(), count)
        measured("list", count, partial(deque, names, maxlen=0))
    server.kill()


if __name__ == "__main__":
    main()
