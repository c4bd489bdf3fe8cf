"""A batch from bucket to bucket whose requests fail and whose processes are killed.

::

    python -m robustness.object_store [--pictures 500] [--engine ray]

A batch of pictures and two videos is done on this machine's disk, then from one bucket into another
one of a real S3 server on this machine, behind a proxy that answers a fifth of all first requests
for an object with 503 SlowDown or 500, or breaks them off before or in the middle of their content.
A third of the way the driver is killed (SIGKILL); the same command then goes on. With ``--engine
ray``, the work is that of a cluster of two workers on this machine, one of which is killed before.
In the end

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
        common += ["--engine", "ray", "--ray-address", _cluster()]
    words = (source.uri(), target.uri("out"), common)
    driver = _batch(*words)
    if engine == "ray":
        _until(target, pictures // 6, driver)
        print(f"workers killed: {_kill_worker()}")
    _until(target, pictures // 3, driver)
    driver.kill()
    driver.wait()
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
    return subprocess.Popen(
        [sys.executable, "-m", "depthcli", "batch", source, "--out", out, *options]
    )


def _fault(method: str, path: str, before: int) -> str | None:
    chance = zlib.crc32(f"{method}{path}{before}".encode())
    if before < 3 and chance % _SHARE == 0:
        return _KINDS[chance // _SHARE % len(_KINDS)]
    return None


def _until(bucket: Bucket, outputs: int, driver: subprocess.Popen[bytes]) -> None:
    while driver.poll() is None and sum(n.endswith(".npy") for n in bucket.names()) < outputs:
        time.sleep(0.5)


def _cluster() -> str:
    """The address of a cluster, which ends with this process."""
    import ray  # noqa: PLC0415 - for one engine only

    from depthcli.jobs.batch.ray import LOCAL_CLUSTER  # noqa: PLC0415

    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    context = ray.init("local", num_cpus=2, log_to_driver=False, **LOCAL_CLUSTER)
    return str(context.address_info["gcs_address"])


def _kill_worker() -> int:
    """End one process that works for the cluster, a child of a child of this one."""
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            is_worker = (folder / "cmdline").read_bytes().startswith(b"ray::RemoteWorker")
            if is_worker and _parent(_parent(folder)).name == str(os.getpid()):
                os.kill(int(folder.name), signal.SIGKILL)
                return 1
    return 0


def _parent(process: Path) -> Path:
    return process.with_name((process / "stat").read_text().rpartition(")")[2].split()[1])


def _files(folder: Path) -> dict[str, bytes]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _rows(data: bytes) -> list[dict[str, object]]:
    return [json.loads(line) for line in data.splitlines()]


if __name__ == "__main__":
    sys.exit(main())
