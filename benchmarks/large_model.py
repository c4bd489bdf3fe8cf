"""Memory of a network of 340 million parameters, against onnxruntime's own.

The network is a ViT-L/14 with a DPT head, as that of Depth Anything V2 large, with random weights
(`pip install '.[train]'` builds it; the file of 1.4 GB is kept with --model). The figure of merit
is the peak resident memory of ``depthcli predict``, ``batch`` and ``video``, divided by that of a
process that only loads the file with onnxruntime and runs it as often (at most 1.15).
All get memory of over 1 MB from the system, without which glibc's own rule makes the peak of one
and the same process either 1.7 or 2.4 GB.
Run: ``python benchmarks/large_model.py [--model FILE] [--images 4] [--command predict ...]``
"""

from __future__ import annotations

import os
import sys
import tempfile
from multiprocessing import Process
from pathlib import Path

from tools import parse_options, peak_bytes, usage, write_images, write_video

from depthcli.core.parallel import usable_cores

SIDE_PX, PATCH_PX, GRID = 518, 14, 37
WIDTH, DEPTH, HEADS = 1024, 24, 16
DPT_LAYERS, FEATURES = (4, 11, 17, 23), 256
CARD = f"""{{
  "schema": 1, "name": "large", "version": "1", "license": "MIT", "camera": null,
  "summary": "ViT-L/14 and DPT of random weights.", "onnx": {{"opset": 17, "ir": 8}},
  "input": {{
    "colour": "rgb", "width": {SIDE_PX}, "height": {SIDE_PX}, "dynamic": false,
    "multiple_of": {PATCH_PX}, "fit": "stretch", "mean": [0.5], "std": [0.25]
  }},
  "output": {{
    "kind": "metric", "transform": "linear", "scale": 1.0, "shift": 1.0,
    "min_m": 0.1, "max_m": 100.0
  }}
}}"""
ALONE = """
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
    from torch.nn.functional import interpolate  # noqa: PLC0415

    class Network(nn.Module):
        """Features of four layers of the transformer, fused from coarse to fine."""

        def __init__(self) -> None:
            super().__init__()
            self.patches = nn.Conv2d(3, WIDTH, PATCH_PX, PATCH_PX)
            self.position = nn.Parameter(torch.randn(1, GRID**2, WIDTH) / 10)
            sizes = {"d_model": WIDTH, "nhead": HEADS, "dim_feedforward": 4 * WIDTH}
            ways = {"activation": "gelu", "batch_first": True, "norm_first": True}
            self.blocks = nn.ModuleList(
                nn.TransformerEncoderLayer(**sizes, **ways) for _ in range(DEPTH)
            )
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
    torch.backends.mha.set_fastpath_enabled(value=False)  # which is not exported
    network = Network().eval()
    count = sum(weights.numel() for weights in network.parameters())
    print(f"{count / 1e6:.0f} million parameters", flush=True)
    image = torch.zeros(1, 3, SIDE_PX, SIDE_PX)
    torch.onnx.export(
        network, (image,), str(path), opset_version=17, dynamo=False, input_names=["image"]
    )
    path.with_suffix(".card.json").write_text(CARD)


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, model=Path, images=4, command=["predict", "batch", "video"])
    os.environ["MALLOC_MMAP_THRESHOLD_"] = str(1 << 20)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = options.model or folder / "large.onnx"
        if not model.exists():
            writer = Process(target=write_model, args=(model,))  # its memory is given back
            writer.start()
            writer.join()
        image = write_images(folder / "in", options.images)[0]
        video = write_video(folder / "clip.avi", options.images)
        inputs = {"predict": image, "batch": folder / "in", "video": video}
        code = ALONE.format(side=SIDE_PX)
        for command in options.command:
            # From the second run on, onnxruntime keeps its plan of the memory, too.
            threads, runs = (1, 1) if command == "predict" else (usable_cores(), 2)
            words = (command, str(inputs[command]), "--model", str(model))
            (folder / "out").mkdir()
            peak_mb = peak_bytes(words, folder / "out") / 1e6
            alone = usage((sys.executable, "-c", code, str(model), str(threads), str(runs)))
            alone_mb = alone.peak_bytes / 1e6
            print(
                f"{command:8} {peak_mb:6.0f} MB; onnxruntime, {threads} at once, "
                f"{alone_mb:6.0f} MB; ratio {peak_mb / alone_mb:.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
