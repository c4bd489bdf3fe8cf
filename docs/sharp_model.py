"""Train and export a network with finer edges from one that was trained: ``sharp`` of ``default``.

The trained network sees the image at half of the size, as before, and gives the low frequencies of
depth. The first stages of its encoder also see the image at full size; a copy of its last two
decoder stages joins them to its map at stride 8, and gives edges. Only these are trained, for
changes of log depth over 1, 2, 4 and 8 pixels, with seven times the weight where true depth changes
by 5 % or more. A box of 33 pixels takes the low frequencies of the one and the high of the other.

Run for the twin, whose held-out pairs give the figures, then for the bundled model::

    python docs/sharp_model.py runs/twin.ckpt --data NYU --held-out --int8 IMAGES -o runs/sharp-7
    python docs/sharp_model.py models/float --data NYU --int8 IMAGES -o models/sharp
"""

import argparse
import copy
import csv
import json
import time
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
import onnx
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.inference.transforms import prepare
from depthcli.io.images.read import read_image
from depthcli.lab.datasets.base import held_out_scenes
from depthcli.lab.export.graph import OPSET, build_graph, check_parity, fold_batch_norm
from depthcli.lab.export.int8 import quantize
from depthcli.lab.training.checkpoint import load_generator
from depthcli.lab.training.config import GeneratorConfig
from depthcli.lab.training.init_weights import load_init_weights, settings_of
from depthcli.lab.training.networks.efficient import resized
from depthcli.lab.training.networks.encoder import EncoderGenerator
from depthcli.lab.training.provenance import DataProvenance
from depthcli.models.card import ModelCard

WIDTH, HEIGHT, BATCH, RATE = 512, 384, 6, 6e-4
BOX_PX = 33
STEPS_PX, STEP, WEIGHT = (1, 2, 4, 8), 0.05, 6
PAIRS = 1000
CARD = Path("models/float/card.json")


class LowFrequencies(nn.Module):
    """Replaces the low frequencies of one map by those of another."""

    def forward(self, fine: Tensor, coarse: Tensor) -> Tensor:
        """(B, 1, H, W) of both, the second of any size."""
        change = F.interpolate(coarse, size=fine.shape[2:], mode="bilinear") - fine
        half = BOX_PX // 2
        change = F.avg_pool2d(F.pad(change, (half, half, 0, 0), mode="replicate"), (1, BOX_PX), 1)
        change = F.avg_pool2d(F.pad(change, (0, 0, half, half), mode="replicate"), (BOX_PX, 1), 1)
        return fine + change


class TwoScales(nn.Module):
    """A network at half of the size, and edges at full size."""

    channels = 1

    def __init__(self, generator: nn.Module) -> None:
        super().__init__()
        self.generator = fold_batch_norm(generator)
        self.fusions = copy.deepcopy(self.generator.fusions[2:])
        self.head = copy.deepcopy(self.generator.head)
        self.correction = LowFrequencies()  # a scope that stays in floats
        for weights in self.generator.parameters():
            weights.requires_grad = False

    def features(self, x: Tensor) -> list[Tensor]:
        """The map at stride 8 and raw depth of the half, and encoder maps at strides 4 and 2."""
        maps = self.generator.maps(F.avg_pool2d(x, 2))[1]
        encoder = self.generator.encoder
        second = encoder.blocks[0](encoder.bn1(encoder.conv_stem(x)))
        return [maps[2], self.generator.head(maps[-1]), encoder.blocks[1](second), second]

    def edges(self, y: Tensor, coarse: Tensor, *skips: Tensor) -> Tensor:
        """Raw depth (B, 1, H/2, W/2) of the features."""
        for fusion, skip in zip(self.fusions, skips, strict=True):
            y = fusion(torch.cat([resized(y, skip), skip], 1))
        return self.correction(self.head(y), coarse)  # type: ignore[no-any-return]

    def forward(self, x: Tensor) -> Tensor:
        """Raw depth (B, 1, H/2, W/2) of x (B, 1, H, W) in [-1, 1]."""
        return self.edges(*self.features(x))


def open_generator(source: Path) -> nn.Module:
    """The generator of a checkpoint, or of a model in floats."""
    if source.suffix == ".ckpt":
        return load_generator(source)[0]
    generator = EncoderGenerator(GeneratorConfig(**settings_of(source)["generator"]))
    load_init_weights(generator, [source / "model.onnx"], DataProvenance(data=""))
    return generator


def change_loss(log_m: Tensor, truth: Tensor) -> Tensor:
    """Differences of the changes of log depth along rows and columns."""
    loss = torch.zeros(())
    for step in STEPS_PX:
        for axis in (-1, -2):
            length = truth.shape[axis] - step
            ours, true = (
                x.narrow(axis, step, length) - x.narrow(axis, 0, length) for x in (log_m, truth)
            )
            weight = 1 + WEIGHT * (true.abs() > STEP).float()
            loss = loss + (weight * (ours - true).abs()).mean()
    return loss


@torch.no_grad()
def features_of(network: TwoScales, folder: Path, *, held_out: bool) -> list[Tensor]:
    """Features of the pairs, stored as half floats, and true log depth at half of the size."""
    with (folder / "index.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if int(row["id"]) < PAIRS]
    scenes = held_out_scenes([row["scene"] for row in rows]) if held_out else set()
    parts: list[list[Tensor]] = [[] for _ in range(5)]
    for row in rows:
        if row["scene"] in scenes:
            continue
        image = cv2.imread(str(folder / "rgb" / f"{row['id']}.jpg")).max(-1)
        depth = cv2.imread(str(folder / "depth" / f"{row['id']}.png"), cv2.IMREAD_UNCHANGED)
        small = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        x = torch.from_numpy(np.float32(small / 127.5 - 1))[None, None]
        size = WIDTH // 2, HEIGHT // 2
        log_m = np.log(cv2.resize(np.float32(depth / 1000), size, interpolation=cv2.INTER_AREA))
        for part, tensor in zip(parts, (*network.features(x), log_m[None, None]), strict=True):
            part.append(torch.as_tensor(tensor)[0].half())
    return [torch.stack(part) for part in parts]


def train(
    network: TwoScales, parts: Sequence[Tensor], codec: tuple[float, float], steps: int
) -> None:
    """Train the last stages."""
    weights = [*network.fusions.parameters(), *network.head.parameters()]
    optimizer = torch.optim.AdamW(weights, RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, steps)
    begin = time.monotonic()
    for step in range(1, steps + 1):
        chosen = torch.randint(len(parts[0]), (BATCH,))
        *features, truth = (part[chosen].float() for part in parts)
        loss = change_loss(network.edges(*features) * codec[0] + codec[1], truth)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % 50 == 0:
            print(f"step {step}  loss {loss:.3f}  {time.monotonic() - begin:.0f} s", flush=True)


def export(network: TwoScales, images: Path | None, out: Path, steps: int) -> None:
    """Write the network, rounded to int8 if there are images, and its card."""
    card = json.loads(CARD.read_text())
    card["input"] |= {"width": WIDTH, "height": HEIGHT, "multiple_of": 8}
    card |= {"name": out.name, "float_model": None, "latency": {}, "scores": {}}
    card["summary"] = "Metric depth of rooms with finer edges, in three times the time; int8."
    network.eval()
    model, batches = build_graph(network), []
    if images is not None:
        spec = ModelCard.from_json(json.dumps(card | {"float_model": None})).input
        files = sorted(images.iterdir())
        batches = [prepare(spec, read_image(file))[0] for file in files[:: len(files) // 64]]
        model = quantize(model, batches, network)
    data = model.SerializeToString()
    tolerance = 0.3 if batches else 1e-3
    print(check_parity(network, data, ((1, HEIGHT, WIDTH),), tolerance, batches))
    out.mkdir(parents=True, exist_ok=True)
    (out / "model.onnx").write_bytes(data)
    card |= {"file": "model.onnx", "sha256": sha256(data).hexdigest(), "bytes": len(data)}
    card["onnx"] = {"opset": OPSET, "ir": onnx.load_from_string(data).ir_version}
    card["training"] |= {"method": "docs/sharp_model.py", "seed": 0, "steps": steps}
    card["training"].pop("precision", None)
    filled = {name: value for name, value in card.items() if value is not None}
    (out / "card.json").write_text(json.dumps(filled, indent=2) + "\n")


def main() -> None:
    """Train and export."""
    parser = argparse.ArgumentParser()
    parser.add_argument("source", type=Path)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--int8", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=1000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    torch.manual_seed(0)
    network = TwoScales(open_generator(options.source).eval()).eval()
    parts = features_of(network, options.data, held_out=options.held_out)
    card = json.loads(CARD.read_text())["output"]
    train(network, parts, (card["scale"], card["shift"]), options.steps)
    options.out.mkdir(parents=True, exist_ok=True)
    torch.save(network.state_dict(), options.out / "network.pt")
    export(network, options.int8, options.out, options.steps)


if __name__ == "__main__":
    main()
