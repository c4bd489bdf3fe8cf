"""A batch from bucket to bucket whose requests fail and whose processes are killed.

::

    python -m robustness.object_store [--pictures 500] [--engine ray]

A batch of pictures and two videos is done on this machine's disk, then from one bucket into another
one of a real S3 server on this machine, behind a proxy that answers a fifth of all first requests
for an object with 503 SlowDown or 500, or breaks them off before or in the middle of their content.
A third of the way the driver is killed (SIGKILL), before it one worker with ``--engine ray``; the
same command then goes on. In the end

- every output has the bytes of the run on the disk, and nothing else is there,
- the manifest has every input once, and no part of a journal is left,
- what was recorded before the driver was killed is not written again.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path

from helpers.stores import KEYS, REGION, Bucket, Faults, s3_server
from helpers.tiny import synthetic_picture, write_model, write_picture
from helpers.videos import flat_frames, write_video

_MARK = "DEPTHCLI_ROBUSTNESS_RUN"
_KINDS = ("503 SlowDown", "500 InternalError", "cut", "drop")
_SHARE = 5


def main() -> int:
    """Run it, and say what fell short."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pictures", type=int, default=500)
    parser.add_argument("--engine", choices=("threads", "ray"), default="threads")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, s3_server() as endpoint:
        return _run(Path(name), endpoint, asked.pictures, asked.engine)


def _run(folder: Path, endpoint: str, pictures: int, engine: str) -> int:
    model = write_model(folder / "model")
    _make(folder / "in", pictures)
    common = ["--model", str(model), "--format", "png16", "--format", "npy", "--quiet"]
    _batch(str(folder / "in"), str(folder / "out"), common).wait()
    wanted = _files(folder / "out")
    wanted.pop("manifest.jsonl")
    source, target = Bucket(endpoint, "robust-in"), Bucket(endpoint, "robust-out")
    for path in (folder / "in").rglob("*.*"):
        source.put(path.relative_to(folder / "in").as_posix(), path.read_bytes())
    faults = Faults(endpoint)
    faults.fault = _fault
    os.environ |= KEYS | {"AWS_DEFAULT_REGION": REGION, "AWS_ENDPOINT_URL": faults.endpoint}
    if engine == "ray":
        common += ["--engine", "ray", "--ray-address", "local", "--workers", "2"]
    words = (source.uri(), target.uri("out"), common)
    driver = _batch(*words)
    if engine == "ray":
        _until(target, pictures // 6)
        print(f"a worker killed: {_kill_worker()}")
    _until(target, pictures // 3)
    driver.kill()
    driver.wait()
    _end_all()
    before = {k: v for k, v in target.objects().items() if ".depthcli-batch" in k}
    recorded = {row["input"]: row for data in before.values() for row in _rows(data)}
    faults.passed.clear()
    code = _batch(*words).wait()
    found = {k.removeprefix("out/"): v for k, v in target.objects().items()}
    rows = _rows(found.pop("manifest.jsonl", b""))
    again = [
        file["path"]
        for row in recorded.values()
        for file in row["outputs"]
        if faults.passed["PUT", f"/{target.name}/out/{file['path']}"]
    ]
    checks = {
        "exit code 0": code == 0,
        f"{len(wanted)} outputs, bytes as on the disk": found == wanted,
        f"{pictures + 2} inputs, each once": sorted(row["input"] for row in rows)
        == sorted(_files(folder / "in")),
        f"{len(recorded)} recorded before the kill, none written again": not again and recorded,
        f"{faults.failed} requests failed of {faults.seen.total()}": faults.failed > 0,
    }
    for what, holds in checks.items():
        print("ok  " if holds else "NOT ", what)
    return 0 if all(checks.values()) else 1


def _make(folder: Path, pictures: int) -> None:
    for number in range(pictures):
        picture = synthetic_picture(24 + number % 7, 32 + number // 7)
        write_picture(folder / f"{number % 10}" / f"{number:04}.png", picture)
    for number in range(2):
        write_video(folder / f"clip{number}.avi", flat_frames(range(40, 240, 10)))


def _batch(source: str, out: str, options: list[str]) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "depthcli", "batch", source, "--out", out, *options]
    return subprocess.Popen(command, env=os.environ | {_MARK: str(os.getpid())})


def _fault(method: str, path: str, before: int) -> str | None:
    chance = zlib.crc32(f"{method}{path}{before}".encode())
    if before < 3 and chance % _SHARE == 0:
        return _KINDS[chance // _SHARE % len(_KINDS)]
    return None


def _until(bucket: Bucket, outputs: int) -> None:
    while sum(name.endswith(".npy") for name in bucket.names()) < outputs:
        time.sleep(0.5)


def _ours() -> dict[int, str]:
    """The processes of this run, by the mark in their environment, and what they are called."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if f"{_MARK}={os.getpid()}".encode() in (entry / "environ").read_bytes():
                found[int(entry.name)] = (entry / "cmdline").read_bytes().decode()
    return found


def _kill_worker() -> str:
    for pid, name in _ours().items():
        if name.startswith("ray::RemoteWorker"):
            os.kill(pid, signal.SIGKILL)
            return name.rstrip("\0")
    return "none found"


def _end_all() -> None:
    """What the cluster of a killed driver leaves."""
    for pid in _ours():
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _files(folder: Path) -> dict[str, bytes]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _rows(data: bytes) -> list[dict[str, object]]:
    return [json.loads(line) for line in data.splitlines()]


if __name__ == "__main__":
    sys.exit(main())
