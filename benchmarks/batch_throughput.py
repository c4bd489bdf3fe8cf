"""How near ``depthcli batch`` comes to what the machine can do, on 640×480 JPEG to 16-bit PNG.

Three figures of merit, from whole processes that take turns. The share of the limit (at least 0.9),
where the limit is cores divided by the summed CPU seconds of all stages of one image, each
measured alone in one thread. The ratio to a plain script of cv2.imread, session.run and
cv2.imwrite, one image after another, on the same model (at least 2). The ratio to ``batch`` in
one process, which differs on more than four cores. The script enlarges depth bilinearly, which is
less work than what ``batch`` does unless told ``--upsample bilinear``, and runs the network on
onnxruntime's own CPU code whatever ``--provider`` says.
Run: ``python benchmarks/batch_throughput.py [--images 500] [--rounds 3] [--upsample bilinear]
[--model fast] [--provider openvino --provider-option KEY=VALUE ...]``
"""

from __future__ import annotations

import hashlib
import shutil
import statistics
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import tools

from depthcli.core.options import Upsampling, UpsamplingOptions
from depthcli.core.parallel import usable_cores
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.images.read import read_image
from depthcli.io.manifest import OK, CacheKey, Journal, ManifestRow, output_entry
from depthcli.jobs.image import write_output
from depthcli.models.catalog import find_model

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

_UNMEASURED = 5

THREADS = """
import sys
from depthcli.cli.app import main
from depthcli.jobs.batch import workers
workers._LEAST_IMAGES = 10**9
sys.exit(main(sys.argv[1:]))
"""


def measure_stages(images: Sequence[Path], out: Path, options: argparse.Namespace) -> tools.Stages:
    """Each stage of ``batch`` in one thread, after five images unmeasured."""
    cv2.setNumThreads(1)
    settings = dict(setting.split("=", 1) for setting in options.provider_option)
    loader = SessionLoader(options.model, options.provider, threads=1, provider_options=settings)
    pipeline = Pipeline(loader.load(), UpsamplingOptions(options.upsample))
    model = pipeline.session.model
    origin = CacheKey("0" * 64, model.card.name, model.sha256, "")
    journal = Journal(out.parent / "rows")
    stages = tools.Stages()
    for number, path in enumerate(images):
        if number == _UNMEASURED:
            stages = tools.Stages()
        data = stages("read", path.read_bytes)
        sha256 = stages("checksum of input", lambda data=data: hashlib.sha256(data).hexdigest())
        frame = stages("decode", read_image, path, data)
        depth = stages("predict", pipeline.predict, frame).depth
        stages("encode and write", write_output, WriterOptions(), Format.PNG16, depth, frame, out)
        file = stages("checksum of output", output_entry, out.parent, out)
        row = ManifestRow(path.name, OK, origin, (file,), 0.04, sha256)
        stages("row of the manifest", journal.add, row)
    journal.finish([])
    return stages


def main() -> None:
    """Measure and print."""
    options = tools.parse_options(
        __doc__,
        images=500,
        rounds=3,
        upsample=Upsampling.GUIDED,
        model="default",
        provider="cpu",
        provider_option=[],
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        images = tools.write_images(folder / "in", options.images)
        size = statistics.mean(path.stat().st_size for path in images)
        print(f"{len(images)} images of {size / 1000:.0f} KB, {usable_cores()} cores")
        compare(folder, images, options)


def compare(folder: Path, images: list[Path], options: argparse.Namespace) -> None:
    """Stages, batch and script in turn."""
    source, out = str(folder / "in"), str(folder / "out")
    words = ["batch", source, "--out", out, "--provider", options.provider]
    words += ["--upsample", options.upsample.value, "--model", options.model]
    for setting in options.provider_option:
        words += ["--provider-option", setting]
    commands = {
        "batch": tools.process(*tools.DEPTHCLI[1:], *words),
        "script": tools.plain_script(find_model(options.model), source, out),
        "one process": tools.process("-c", THREADS, *words),
    }
    rates: dict[str, list[float]] = {name: [] for name in ("limit", *commands)}
    for _ in range(options.rounds):
        stages_s = measure_stages(images[:65], folder / "one.png", options).each_s()
        rates["limit"].append(usable_cores() / sum(stages_s.values()))
        for name, command in commands.items():
            rates[name].append(len(images) / tools.wall_s(command))
            shutil.rmtree(out)
        print("  ".join(f"{name} {values[-1]:.1f}/s" for name, values in rates.items()))
    tools.print_stages(stages_s)
    tools.print_spread("share of the limit", tools.ratios(rates["batch"], rates["limit"]))
    tools.print_spread("ratio to the script", tools.ratios(rates["batch"], rates["script"]))
    tools.print_spread("ratio to one process", tools.ratios(rates["batch"], rates["one process"]))


if __name__ == "__main__":
    main()
