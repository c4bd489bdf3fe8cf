"""Latency, throughput and memory of ``depthcli serve`` under load.

Figures of merit: answers a second with 16 clients ÷ images a second of ``batch`` on the same image
(both with one worker a core and 16-bit PNG), p50 and p99 of an answer with 1, 4 and 16 clients, and
resident memory every thousand requests. Clients keep their connections; they run on the same cores.
Run: ``python benchmarks/serve_load.py [--image IMAGE] [--requests 20000] [--model default]``
"""

from __future__ import annotations

import http.client
import shutil
import subprocess
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from tools import DEPTHCLI, ROOM, parse_options, process, wall_s

CLIENTS = (1, 4, 16)
BATCH = 400
STEP = 1000


def memory_mb(process_id: int) -> float:
    """Resident memory of a process."""
    status = Path(f"/proc/{process_id}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def load(address: str, image: bytes, clients: int, requests: int) -> tuple[float, np.ndarray]:
    """Send requests from several clients; answers a second, and milliseconds of each request."""
    numbers = count()

    def client(_: int) -> list[float]:
        connection, seconds = http.client.HTTPConnection(address), []
        while next(numbers) < requests:
            start = time.perf_counter()
            connection.request("POST", "/predict", image)
            reply = connection.getresponse()
            reply.read()
            if reply.status != 200:
                raise SystemExit(f"status {reply.status}")
            seconds.append(time.perf_counter() - start)
        return seconds

    start = time.perf_counter()
    with ThreadPoolExecutor(clients) as pool:
        seconds = [each for part in pool.map(client, range(clients)) for each in part]
    return requests / (time.perf_counter() - start), np.array(seconds) * 1e3


def batch_rate(image: Path, model: str, images: int) -> float:
    """Images a second of ``batch``, without its start, by two folders of different size."""
    seconds = []
    for number in (images // 4, images):
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "in"
            source.mkdir()
            for index in range(number):
                shutil.copy(image, source / f"{index}{image.suffix}")
            words = ["batch", str(source), "-o", f"{folder}/out", "--format", "png16", "-q"]
            seconds.append(wall_s(process(*DEPTHCLI[1:], *words, "--model", model)))
    return (images - images // 4) / (seconds[1] - seconds[0])


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, image=ROOM, requests=20_000, model="default", batch=BATCH)
    image = options.image.read_bytes()
    server = subprocess.Popen(
        [*DEPTHCLI, "serve", "--port", "0", "--queue", "64", "--model", options.model],
        stderr=subprocess.PIPE,
        text=True,
    )
    address = urlsplit(server.stderr.readline().strip()).netloc
    load(address, image, 4, 100)
    before = batch_rate(options.image, options.model, options.batch)
    for clients in CLIENTS:
        rate, each_ms = load(address, image, clients, options.batch)
        p50, p99 = np.percentile(each_ms, [50, 99])
        print(f"{clients:2} clients: {rate:6.1f}/s, p50 {p50:.1f} ms, p99 {p99:.1f} ms")
    after = batch_rate(options.image, options.model, options.batch)
    print(f"batch: {before:.1f} and {after:.1f} images/s, before and after")
    print(f"serve ÷ batch: {rate / np.mean([before, after]):.2f}")
    for requests in range(0, options.requests, STEP):
        print(f"{requests:6} requests: {memory_mb(server.pid):.0f} MB", flush=True)
        load(address, image, 4, STEP)
    print(f"{options.requests:6} requests: {memory_mb(server.pid):.0f} MB")
    server.terminate()


if __name__ == "__main__":
    main()
