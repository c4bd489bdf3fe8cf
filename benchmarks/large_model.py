"""Memory and time of a network of 340 million parameters, against onnxruntime's own.

The network is a ViT-L/14 with a DPT head, as that of Depth Anything V2 large, with random weights
(`pip install '.[train]'` builds it; the file of 1.4 GB is kept with --model). The figure of merit
is the peak resident memory of ``depthcli predict``, ``batch`` and ``video``, divided by that of a
process that only loads the file with onnxruntime and runs it as often (at most 1.15).
All get memory of over 1 MB from the system, without which glibc's own rule makes the peak of one
and the same process either 1.7 or 2.4 GB.
Run: ``python benchmarks/large_model.py [--model FILE] [--images 4] [--command predict ...]``
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from multiprocessing import Process
from pathlib import Path
from typing import NamedTuple

from tools import peak_bytes, peak_of, write_pictures, write_video

SIDE_PX, PATCH_PX, GRID = 518, 14, 37
WIDTH, DEPTH, HEADS = 1024, 24, 16
DPT_LAYERS, FEATURES = (4, 11, 17, 23), 256
CARD = {
    "schema": 1,
    "name": "large",
    "version": "1",
    "summary": "ViT-L/14 and DPT of random weights.",
    "license": "MIT",
    "input": {
        "colour": "rgb",
        "width": SIDE_PX,
        "height": SIDE_PX,
        "dynamic": False,
        "multiple_of": PATCH_PX,
        "fit": "stretch",
        "mean": [0.5],
        "std": [0.25],
    },
    "output": {
        "kind": "metric",
        "transform": "linear",
        "scale": 1.0,
        "shift": 1.0,
        "min_m": 0.1,
        "max_m": 100.0,
    },
    "camera": None,
    "onnx": {"opset": 17, "ir": 8},
}
OWN = """
import sys, threading
import numpy as np
import onnxruntime as ort
options = ort.SessionOptions()
options.add_session_config_entry("session.intra_op.allow_spinning", "0")
session = ort.InferenceSession(sys.argv[1], options, ["CPUExecutionProvider"])
image = np.zeros((1, 3, {side}, {side}), np.float32)
feed = {{session.get_inputs()[0].name: image}}
def run():
    for _ in range(int(sys.argv[3])): session.run(None, feed)
runs = [threading.Thread(target=run) for _ in range(int(sys.argv[2]))]
for run in runs: run.start()
for run in runs: run.join()
"""


def write_model(path: Path) -> None:
    """Build the network, and write it as one ONNX file with its card beside it."""
    import torch  # noqa: PLC0415 - in an extra
    from torch import nn  # noqa: PLC0415
    from torch.nn.functional import interpolate, scaled_dot_product_attention  # noqa: PLC0415

    class Block(nn.Module):
        """A block of a vision transformer, (N, tokens, WIDTH)."""

        def __init__(self) -> None:
            super().__init__()
            self.norms = nn.ModuleList(nn.LayerNorm(WIDTH) for _ in range(2))
            self.qkv, self.out = nn.Linear(WIDTH, 3 * WIDTH), nn.Linear(WIDTH, WIDTH)
            self.mlp = nn.Sequential(
                nn.Linear(WIDTH, 4 * WIDTH), nn.GELU(), nn.Linear(4 * WIDTH, WIDTH)
            )

        def forward(self, tokens: torch.Tensor) -> torch.Tensor:
            heads = self.qkv(self.norms[0](tokens)).reshape(1, -1, 3, HEADS, WIDTH // HEADS)
            seen = scaled_dot_product_attention(*heads.permute(2, 0, 3, 1, 4))
            tokens = tokens + self.out(seen.transpose(1, 2).reshape(1, -1, WIDTH))
            return tokens + self.mlp(self.norms[1](tokens))

    class Network(nn.Module):
        """Features of four layers of the transformer, fused from coarse to fine."""

        def __init__(self) -> None:
            super().__init__()
            self.patches = nn.Conv2d(3, WIDTH, PATCH_PX, PATCH_PX)
            self.position = nn.Parameter(torch.randn(1, GRID**2, WIDTH) / 10)
            self.blocks = nn.ModuleList(Block() for _ in range(DEPTH))
            self.reduce = nn.ModuleList(
                nn.Sequential(nn.Conv2d(WIDTH, WIDTH, 3, 1, 1), nn.Conv2d(WIDTH, FEATURES, 1))
                for _ in DPT_LAYERS
            )
            self.fuse = nn.ModuleList(nn.Conv2d(FEATURES, FEATURES, 3, 1, 1) for _ in DPT_LAYERS)
            self.head = nn.Sequential(
                nn.Conv2d(FEATURES, 32, 3, 1, 1), nn.ReLU(), nn.Conv2d(32, 1, 1), nn.Sigmoid()
            )

        def forward(self, image: torch.Tensor) -> torch.Tensor:
            """Depth (1, 1, H, W) of normalized RGB (1, 3, H, W)."""
            tokens = self.patches(image).flatten(2).transpose(1, 2) + self.position
            fused, number = torch.zeros(1, FEATURES, GRID, GRID), 0
            for layer, block in enumerate(self.blocks):
                tokens = block(tokens)
                if layer in DPT_LAYERS:
                    features = tokens.transpose(1, 2).reshape(1, WIDTH, GRID, GRID)
                    fused = self.fuse[number](self.reduce[number](features) + fused)
                    number += 1
            fused = interpolate(fused, scale_factor=8, mode="bilinear")
            return interpolate(self.head(fused), (SIDE_PX, SIDE_PX), mode="bilinear")

    torch.manual_seed(0)
    network = Network().eval()
    count = sum(weights.numel() for weights in network.parameters())
    print(f"{count / 1e6:.0f} million parameters")
    image = torch.zeros(1, 3, SIDE_PX, SIDE_PX)
    torch.onnx.export(
        network, (image,), str(path), opset_version=17, dynamo=False, input_names=["image"]
    )
    path.with_suffix(".card.json").write_text(json.dumps(CARD))


class Measured(NamedTuple):
    """Peak memory and time of a process."""

    peak_mb: float
    seconds: float


def measured(peak: int, start: float) -> Measured:
    """A measurement that began at a time."""
    return Measured(peak / 1e6, time.perf_counter() - start)


def own(model: Path, at_once: int, times: int) -> Measured:
    """Load and run the file with onnxruntime alone, in threads that each run it several times."""
    start = time.perf_counter()
    code = OWN.format(side=SIDE_PX)
    return measured(
        peak_of((sys.executable, "-c", code, str(model), str(at_once), str(times))), start
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--images", type=int, default=4)
    parser.add_argument("--command", nargs="+", choices=("predict", "batch", "video"))
    options = parser.parse_args()
    os.environ["MALLOC_MMAP_THRESHOLD_"] = str(1 << 20)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = options.model or folder / "large.onnx"
        if not model.exists():
            writer = Process(target=write_model, args=(model,))  # its memory is given back
            writer.start()
            writer.join()
        image = write_pictures(folder / "in", options.images)[0]
        video = write_video(folder / "clip.avi", options.images)
        cores = len(os.sched_getaffinity(0))
        commands = {
            "predict": (1, ("predict", str(image))),
            "batch": (cores, ("batch", str(folder / "in"))),
            "video": (cores, ("video", str(video))),
        }
        for command in options.command or commands:
            at_once, words = commands[command]
            # From the second run on, onnxruntime keeps its plan of the memory, too.
            alone = own(model, at_once, 1 if command == "predict" else 2)
            (folder / "out").mkdir()
            start = time.perf_counter()
            peak = peak_bytes((*words, "--model", str(model)), folder / "out")
            whole = measured(peak, start)
            print(
                f"{command:8} {whole.peak_mb:6.0f} MB, {whole.seconds:5.1f} s; onnxruntime, "
                f"{at_once} at once, {alone.peak_mb:6.0f} MB, {alone.seconds:5.1f} s; "
                f"ratio {whole.peak_mb / alone.peak_mb:.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
