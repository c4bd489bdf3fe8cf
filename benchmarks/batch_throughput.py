"""How near ``depthcli batch`` comes to what the machine can do, on 640×480 JPEG to 16-bit PNG.

Three figures of merit, from whole processes that take turns. The share of the limit (at least 0.9),
where the limit is cores divided by the summed CPU seconds of all stages of one picture, each
measured alone in one thread. The ratio to a plain script of cv2.imread, session.run and
cv2.imwrite, one picture after another, on the same model (at least 2). The ratio to ``batch`` in
one process, which differs on more than four cores. The script enlarges depth bilinearly, which is
less work than what ``batch`` does unless told ``--upsample bilinear``, and runs the network on
onnxruntime's own CPU code whatever ``--provider`` says.
Run: ``python benchmarks/batch_throughput.py [--pictures 500] [--rounds 3] [--upsample bilinear]
[--model fast] [--provider openvino --provider-option KEY=VALUE ...]``
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import cv2
from tools import write_pictures

from depthcli.core.options import Upsampling, UpsamplingOptions
from depthcli.core.parallel import usable_cores
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.images.read import read_image
from depthcli.io.manifest import OK, CacheKey, Journal, ManifestRow, output_entry
from depthcli.jobs.write import write_output
from depthcli.models.catalog import find_model

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_Result = TypeVar("_Result")
_UNMEASURED = 5

PLAIN = """
import os, sys, cv2, numpy as np, onnxruntime
folder, model, out, width, height = sys.argv[1:]
session = onnxruntime.InferenceSession(model)
name = session.get_inputs()[0].name
os.makedirs(out)
for file in sorted(os.listdir(folder)):
    image = cv2.imread(os.path.join(folder, file))
    value = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)[..., 2]
    gray = cv2.resize(value, (int(width), int(height)), interpolation=cv2.INTER_AREA)
    batch = (gray.astype(np.float32) / 127.5 - 1)[None, None]
    raw = session.run(None, {name: batch})[0][0, 0]
    depth = cv2.resize(np.exp(raw), image.shape[1::-1])
    cv2.imwrite(os.path.join(out, file + ".png"), (depth * 1000).astype(np.uint16))
"""

THREADS = """
import sys
from depthcli.cli.app import main
from depthcli.jobs.batch import engine
engine._LEAST_IMAGES = 10**9
sys.exit(main(sys.argv[1:]))
"""


class Stages:
    """CPU seconds of each stage over several pictures."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}

    def __call__(self, name: str, action: Callable[[], _Result]) -> _Result:
        """Measure one stage of one picture."""
        start = time.process_time()
        result = action()
        self.seconds.setdefault(name, []).append(time.process_time() - start)
        return result

    @property
    def total_s(self) -> float:
        """CPU seconds of one picture."""
        return sum(map(statistics.median, self.seconds.values()))


def measure_stages(pictures: Sequence[Path], out: Path, how: argparse.Namespace) -> Stages:
    """Each stage of ``batch`` in one thread, after five pictures unmeasured."""
    cv2.setNumThreads(1)
    settings = dict(setting.split("=", 1) for setting in how.provider_option)
    loader = SessionLoader(how.model, how.provider, threads=1, provider_options=settings)
    pipeline = Pipeline(loader.load(), UpsamplingOptions(how.upsample))
    options = WriterOptions()
    model = pipeline.session.model
    origin = CacheKey("0" * 64, model.card.name, model.sha256, "")
    journal = Journal(out.parent / "rows")
    stages = Stages()
    for number, path in enumerate(pictures):
        if number == _UNMEASURED:
            stages = Stages()
        data = stages("read", path.read_bytes)
        sha256 = stages("checksum of input", partial(_sha256, data))
        frame = stages("decode", partial(read_image, path, data))
        depth = stages("predict", partial(pipeline.predict, frame)).depth
        stages(
            "encode and write",
            partial(write_output, options, Format.PNG16, depth, frame, out),
        )
        file = stages("checksum of output", partial(output_entry, out.parent, out))
        row = ManifestRow(path.name, OK, origin, (file,), 0.04, sha256)
        stages("row of the manifest", partial(journal.add, row))
    journal.finish([])
    return stages


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def timed(*command: str) -> float:
    """Wall seconds of a process."""
    start = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=500)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--upsample", type=Upsampling, default=Upsampling.GUIDED)
    parser.add_argument("--model", default="default")
    parser.add_argument("--provider", default="cpu")
    parser.add_argument("--provider-option", action="append", default=[])
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pictures = write_pictures(folder / "in", options.pictures)
        size = statistics.mean(path.stat().st_size for path in pictures)
        print(f"{len(pictures)} pictures of {size / 1000:.0f} KB, {usable_cores()} cores")
        compare(folder, pictures, options)


def compare(folder: Path, pictures: list[Path], how: argparse.Namespace) -> None:
    """Stages, batch and script in turn."""
    model = find_model(how.model)
    spec = model.card.input
    sizes = (str(spec.width), str(spec.height))
    source, out = str(folder / "in"), str(folder / "out")
    words = ["batch", source, "--out", out, "--provider", how.provider]
    words += ["--upsample", how.upsample.value, "--model", how.model]
    for word in how.provider_option:
        words += ["--provider-option", word]
    batch = (sys.executable, "-m", "depthcli", *words)
    threads = (sys.executable, "-c", THREADS, *words)
    script = (sys.executable, "-c", PLAIN, source, str(model.path), out, *sizes)
    shares, ratios, gains = [], [], []
    for _ in range(how.rounds):
        stages = measure_stages(pictures[:65], folder / "one.png", how)
        walls = []
        for command in (batch, script, threads):
            walls.append(timed(*command))
            shutil.rmtree(out)
        limit = usable_cores() / stages.total_s
        rate, plain_rate, thread_rate = (len(pictures) / wall for wall in walls)
        shares.append(rate / limit)
        ratios.append(rate / plain_rate)
        gains.append(rate / thread_rate)
        print(f"limit {limit:.1f}/s  batch {rate:.1f}/s  script {plain_rate:.1f}/s")
    for stage, seconds in stages.seconds.items():
        print(f"  {stage:<20} {statistics.median(seconds) * 1e3:6.2f} ms CPU")
    print(f"share of the limit {statistics.median(shares):.3f}  ({spread(shares)})")
    print(f"ratio to the script {statistics.median(ratios):.2f}  ({spread(ratios)})")
    print(f"ratio to one process {statistics.median(gains):.2f}  ({spread(gains)})")


def spread(values: Sequence[float]) -> str:
    """The least and the largest."""
    return f"{min(values):.3f} to {max(values):.3f}"


if __name__ == "__main__":
    main()
