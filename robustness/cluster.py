"""Pictures and videos from bucket to bucket on a Ray cluster, with everything going wrong.

    python -m robustness.cluster                  # 500 pictures, 2 videos: some minutes
    python -m robustness.cluster --pictures 60

A real S3 server and a real Ray cluster of two workers, both on this machine. Of the requests to the
server some are told to slow down, some answers are cut and some never come. When a third of the
outputs is there a worker is killed, when two thirds are, the driver; then the same command is run
again. The bucket must hold the bytes that a single machine makes of the same files, nothing missing
and nothing else, and the manifest one row for each input. Prints what happened; exits with 1 if
anything fell short.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import ray
from helpers.stores import KEYS, REGION, Bucket, Faults, s3_server
from helpers.tiny import synthetic_picture, write_model, write_picture
from helpers.videos import flat_frames, write_video

from depthcli.jobs.batch.ray import LOCAL_CLUSTER

MANIFEST = "manifest.jsonl"


def fault(method: str, path: str, before: int) -> str | None:
    """Of one request in five, the first two times: what goes wrong with it."""
    kind = hashlib.sha256(f"{method} {path}".encode()).digest()[0] % 15
    kinds = ("503 SlowDown", "cut" if method == "GET" else "drop", "drop")
    return kinds[kind] if before < 2 and kind < len(kinds) else None


def made(folder: Path, pictures: int) -> None:
    """The inputs."""
    for number in range(pictures):
        write_picture(
            folder / f"{number % 7}" / f"{number:04}.png", synthetic_picture(48, 64 + number % 50)
        )
    for number in (1, 2):
        write_video(folder / "clips" / f"{number}.avi", flat_frames(range(0, 200, 20 * number)))


def files(folder: Path) -> dict[str, bytes]:
    """Names and content, without the manifest."""
    found = {
        path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()
    }
    return {name: path.read_bytes() for name, path in found.items() if name != MANIFEST}


def keys(bucket: Bucket) -> list[str]:
    """The outputs that are in the bucket."""
    pages = bucket.client.get_paginator("list_objects_v2").paginate(
        Bucket=bucket.name, Prefix="out/"
    )
    return [
        one["Key"] for page in pages for one in page.get("Contents", ()) if "/." not in one["Key"]
    ]


def kill_a_worker() -> int:
    """End one process that works for the cluster that this process has begun."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            name = (folder / "cmdline").read_text()
            parent = (folder / "stat").read_text().rpartition(")")[2].split()[1]
            above = Path(f"/proc/{parent}/stat").read_text().rpartition(")")[2].split()[1]
        except OSError:
            continue
        if name.startswith("ray::RemoteWorker") and int(above) == os.getpid():
            os.kill(int(folder.name), signal.SIGKILL)
            return 1
    return 0


def wait_for(bucket: Bucket, count: int, driver: subprocess.Popen[bytes]) -> None:
    """Until so many outputs are there."""
    while len(keys(bucket)) < count and driver.poll() is None:
        time.sleep(0.2)


def batch(folder: Path, source: str, out: str, *more: str) -> list[str]:
    """The command."""
    words = ["batch", source, "--out", out, "--model", str(folder / "model"), "--provider", "cpu"]
    return [sys.executable, "-m", "depthcli", *words, "--json", *more]


def interrupted(command: list[str], bucket: Bucket, wanted: int) -> list[dict[str, object]]:
    """Begin it, kill a worker, kill it, and run it again; the rows that the last run prints."""
    start = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as driver:
        wait_for(bucket, wanted // 3, driver)
        say(start, f"{len(keys(bucket))} outputs; workers killed: {kill_a_worker()}")
        wait_for(bucket, 2 * wanted // 3, driver)
        say(start, f"{len(keys(bucket))} outputs; driver's exit code: {driver.poll()}")
        driver.kill()
    done = subprocess.run(command, stdout=subprocess.PIPE, check=False)
    say(start, f"exit code {done.returncode}")
    return [json.loads(line) for line in done.stdout.splitlines()]


def say(start: float, what: str) -> None:
    """A line with the time."""
    print(f"{time.perf_counter() - start:6.1f} s  {what}", flush=True)


def compare(bucket: Bucket, folder: Path, rows: list[dict[str, object]], inputs: int) -> list[str]:
    """What fell short."""
    wanted = files(folder / "alone")
    objects = {
        k.removeprefix("out/"): v for k, v in bucket.objects().items() if k.startswith("out/")
    }
    manifest = objects.pop(MANIFEST, b"").splitlines()
    names = Counter(json.loads(line)["input"] for line in manifest)
    told = Counter(str(row["input"]) for row in rows)
    kept = sum(bool(row["kept"]) for row in rows)
    print(
        f"{len(objects)} outputs, {len(manifest)} rows, {kept} of {len(rows)} kept by the last run"
    )
    short = {
        "outputs that are missing": sorted(wanted.keys() - objects.keys()),
        "objects that are no output": sorted(objects.keys() - wanted.keys()),
        "outputs with other bytes": [n for n in wanted if objects.get(n, wanted[n]) != wanted[n]],
        "inputs told or listed more than once": [n for n in names | told if (names | told)[n] > 1],
        "rows that are missing": [] if len(names) == len(told) == inputs else [str(inputs)],
        "failures": [str(row["error"]) for row in rows if row["error"]],
        "nothing was kept": [] if kept else ["0"],
    }
    return [f"{what}: {', '.join(which[:5])}" for what, which in short.items() if which]


def main() -> int:
    """Run and compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=500)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as where, s3_server() as endpoint:
        folder, bucket = Path(where), Bucket(endpoint, "pictures")
        made(folder / "in", options.pictures)
        write_model(folder / "model", camera={"hfov_deg": 60.0})
        alone = batch(folder, str(folder / "in"), str(folder / "alone"))
        subprocess.run(alone, check=True, stdout=subprocess.DEVNULL)
        for path in (folder / "in").rglob("*.*"):
            bucket.put(f"in/{path.relative_to(folder / 'in').as_posix()}", path.read_bytes())
        proxy = Faults(endpoint)
        proxy.fault = fault
        os.environ.update(KEYS, AWS_DEFAULT_REGION=REGION, AWS_ENDPOINT_URL=proxy.endpoint)
        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
        address = ray.init("local", num_cpus=2, log_to_driver=False, **LOCAL_CLUSTER).address_info[
            "gcs_address"
        ]
        command = batch(folder, bucket.uri("in"), bucket.uri("out"), "--engine", "ray")
        rows = interrupted([*command, "--ray-address", address], bucket, options.pictures)
        ray.shutdown()
        print(f"{sum(proxy.seen.values())} requests")
        short = compare(bucket, folder, rows, options.pictures + 2)
    print("\n".join(short) or "the bytes of a single machine, nothing missing, nothing twice")
    return bool(short)


if __name__ == "__main__":
    sys.exit(main())
