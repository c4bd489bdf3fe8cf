"""Latency, throughput and memory of ``depthcli serve`` under load.

Figures of merit: answers a second with 16 clients ÷ images a second of ``batch`` on the same image
(both with one worker a core and 16-bit PNG), p50 and p99 of an answer with 1, 4 and 16 clients, and
resident memory every thousand requests. Clients keep their connections; they run on the same cores.
Run: ``python benchmarks/serve_load.py [IMAGE] [--requests 20000] [--model default]``
"""

from __future__ import annotations

import argparse
import http.client
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from depthcli.core.parallel import usable_cores

PICTURE = Path(__file__).parents[1] / "docs" / "room.jpg"
DEPTHCLI = [sys.executable, "-m", "depthcli"]
CLIENTS = (1, 4, 16)
BATCH = 400
STEP = 1000


def memory_mb(process: int) -> float:
    """Resident memory of a process."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def load(address: str, image: bytes, clients: int, requests: int) -> tuple[float, np.ndarray]:
    """Send requests from several clients; seconds in all and of each request."""
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
        found = [one for each in pool.map(client, range(clients)) for one in each]
    return time.perf_counter() - start, np.array(found)


def batch_rate(image: Path, model: str) -> float:
    """Images a second of ``batch``, without its start, by two folders of different size."""
    seconds = []
    for number in (BATCH // 4, BATCH):
        with tempfile.TemporaryDirectory() as folder:
            pictures = Path(folder) / "in"
            pictures.mkdir()
            for index in range(number):
                shutil.copy(image, pictures / f"{index}{image.suffix}")
            words = ["batch", str(pictures), "-o", f"{folder}/out", "--format", "png16", "-q"]
            start = time.perf_counter()
            subprocess.run([*DEPTHCLI, *words, "--model", model], check=True)
            seconds.append(time.perf_counter() - start)
    return (BATCH - BATCH // 4) / (seconds[1] - seconds[0])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("image", nargs="?", type=Path, default=PICTURE)
    parser.add_argument("--requests", type=int, default=20_000)
    parser.add_argument("--model", default="default")
    options = parser.parse_args()
    image = options.image.read_bytes()
    server = subprocess.Popen(
        [*DEPTHCLI, "serve", "--port", "0", "--queue", "64", "--model", options.model],
        stderr=subprocess.PIPE,
        text=True,
    )
    address = urlsplit(server.stderr.readline().strip()).netloc
    load(address, image, 4, 100)
    before = batch_rate(options.image, options.model)
    rates, own_s = {}, 0.0
    for clients in CLIENTS:
        own_s = time.process_time()
        seconds, each = load(address, image, clients, BATCH)
        own_s = time.process_time() - own_s
        rates[clients] = BATCH / seconds
        p50, p99 = np.percentile(each * 1e3, [50, 99])
        print(f"{clients:2} clients: {rates[clients]:6.1f}/s, p50 {p50:.1f} ms, p99 {p99:.1f} ms")
    after = batch_rate(options.image, options.model)
    print(f"batch: {before:.1f} and {after:.1f} images/s, before and after")
    share = rates[CLIENTS[-1]] / np.mean([before, after])
    without = BATCH / (BATCH / rates[CLIENTS[-1]] - own_s / usable_cores())
    own = without / np.mean([before, after])
    print(f"serve ÷ batch: {share:.2f}; without the clients' own CPU time {own:.2f}")
    for done in range(0, options.requests, STEP):
        print(f"{done:6} requests: {memory_mb(server.pid):.0f} MB", flush=True)
        load(address, image, 4, STEP)
    print(f"{options.requests:6} requests: {memory_mb(server.pid):.0f} MB")
    server.terminate()


if __name__ == "__main__":
    main()
