"""Train a network that gives the relative error which the depth of another is expected to have.

The other network stays as it is. A head of 0.1 million weights sees the four maps of its decoder,
its depth and its input, and learns the log of the mean of |log error| (likelihood of Laplace) from
two sources: the errors on the pairs that the network was trained on, which are too small but in the
right places, and its distance to the labels of photographs, of which two thirds of the factor
between both are left out. A line through the logs of errors makes their mean right on pairs that
the network has not seen.

Run for the twin, whose held-out pairs give the figures and the line, then for the bundled model::

    python docs/error_head.py runs/twin --data NYU --photographs DIR --labels DIR -o runs/twin-error
    python docs/error_head.py models/default ... -o models/error --line A B

A label is an 8-bit image of 0.2 · 60^(value / 255) metres.
"""

import argparse
import csv
import json
import time
from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime as ort
import torch
import torch.nn.functional as F  # noqa: N812
from onnx.compose import add_prefix
from torch import Tensor, nn

from depthcli.lab.datasets.base import held_out_scenes

OUTPUT = "error"
CHANNELS = (128, 96, 48, 16)  # of the decoder, from the coarsest map
WIDTH, BATCH, RATE = 48, 12, 3e-3
PREFIX = "head/"
PAIRS = 1000  # that may be looked at


class ErrorHead(nn.Module):
    """Maps of a decoder, its depth and its input to the log of the expected |log error|."""

    def __init__(self, codec: tuple[float, float], line: tuple[float, float] = (0.0, 1.0)) -> None:
        super().__init__()
        self.codec, self.line = codec, line
        self.maps = nn.ModuleList(nn.Conv2d(channels, WIDTH, 1) for channels in CHANNELS)
        self.depth = nn.Conv2d(5, WIDTH, 3, padding=1)
        self.image = nn.Sequential(
            nn.Conv2d(1, 16, 5, 2, 2), nn.ReLU(), nn.Conv2d(16, WIDTH, 3, 2, 1)
        )
        self.norm, self.dropout = nn.BatchNorm2d(WIDTH), nn.Dropout2d(0.2)
        self.near, self.far, self.farther = (
            nn.Conv2d(WIDTH, WIDTH, 3, padding=gap, dilation=gap) for gap in (1, 2, 4)
        )
        self.whole, self.head = nn.Linear(WIDTH, WIDTH), nn.Conv2d(WIDTH, 1, 1)

    def forward(self, image: Tensor, raw: Tensor, *maps: Tensor) -> Tensor:
        """(B, 1, h, w) of an image (B, 1, 4h, 4w), raw depth (B, 1, 2h, 2w) and the maps."""
        scale, shift = self.codec
        log_m = raw * scale + shift
        small = F.avg_pool2d(log_m, 2)
        fine = F.avg_pool2d((log_m - F.interpolate(small, scale_factor=2.0)).abs(), 2)
        right = F.pad((small[..., 1:] - small[..., :-1]).abs(), (0, 1))
        down = F.pad((small[..., 1:, :] - small[..., :-1, :]).abs(), (0, 0, 0, 1))
        rows = torch.cumsum(torch.ones_like(small), 2)
        rows = rows / rows[:, :, -1:] * 2 - 1
        x = self.depth(torch.cat([small, right * 5, down * 5, fine * 10, rows], 1))
        x = x + self.image(image)
        for layer, features in zip(self.maps, maps, strict=True):
            part = layer(features)
            if part.shape[2] > x.shape[2]:
                part = F.avg_pool2d(part, 2)
            x = x + F.interpolate(part, size=x.shape[2:], mode="bilinear")
        x = self.dropout(F.relu(self.norm(x)))
        x = F.relu(self.near(x)) + x
        x = F.relu(self.far(x) + self.whole(x.mean((2, 3)))[:, :, None, None]) + x
        x = F.relu(self.farther(x)) + x
        log_error = self.head(x) - 2.1
        return log_error if self.training else log_error * self.line[1] + self.line[0]


class RelativeError(nn.Module):
    """The output of the model: the error itself, not its log."""

    def __init__(self, head: ErrorHead) -> None:
        super().__init__()
        self.head = head

    def forward(self, *inputs: Tensor) -> Tensor:
        """(B, 1, h, w), as of the head."""
        return self.head(*inputs).exp()  # type: ignore[no-any-return]


class Samples:
    """What a network sees, says and should have said, of some images."""

    def __init__(self, model: Path, images: Iterator[tuple[np.ndarray, np.ndarray]]) -> None:
        card = json.loads((model / "card.json").read_text())
        self.codec = card["output"]["scale"], card["output"]["shift"]
        width, height = card["input"]["width"], card["input"]["height"]
        network = onnx.load(model / "model.onnx")
        names = decoder_maps(network)
        for name in names:
            network.graph.output.append(onnx.helper.make_empty_tensor_value_info(name))
        options = ort.SessionOptions()
        options.intra_op_num_threads = 1
        session = ort.InferenceSession(network.SerializeToString(), options)
        parts: list[list[np.ndarray]] = [[] for _ in range(3 + len(names))]
        for value, truth_m in images:
            small = cv2.resize(value, (width, height), interpolation=cv2.INTER_AREA)
            image = np.float32(small / 127.5 - 1)[None, None]
            raw, *maps = session.run(["depth", *names], {"image": image})
            size = raw.shape[:1:-1]
            truth = np.log(cv2.resize(truth_m, size, interpolation=cv2.INTER_AREA).clip(0.2, 12))
            truth = truth[None, None]
            row = image, raw, truth, *maps
            for part, array in zip(parts, row, strict=True):
                part.append(array[0].astype(np.float32 if array is truth else np.float16))
        self.parts = [torch.from_numpy(np.stack(parts.pop(0))) for _ in range(len(parts))]

    def __len__(self) -> int:
        return len(self.parts[0])

    def log_m(self, chosen: Tensor) -> Tensor:
        """The network's log depth."""
        return self.parts[1][chosen].float() * self.codec[0] + self.codec[1]

    def batch(self, chosen: Tensor, *, mirrored: bool = False) -> tuple[list[Tensor], Tensor]:
        """Inputs of the head, and |log error| at its size."""
        image, raw, truth, *maps = (part[chosen].float() for part in self.parts)
        error = F.avg_pool2d((self.log_m(chosen) - truth).abs(), 2)
        turn = (lambda x: x.flip(-1)) if mirrored else (lambda x: x)
        return [turn(x) for x in (image, raw, *maps)], turn(error)

    def forgive(self, share: float) -> None:
        """Leave out a share of the factor between depth and truth of each image."""
        factor = (self.log_m(torch.arange(len(self))) - self.parts[2]).flatten(1).median(1).values
        self.parts[2] += share * factor[:, None, None, None]


def decoder_maps(network: onnx.ModelProto) -> list[str]:
    """Names of the decoder's maps, in int8 graphs after they are quantized."""
    outputs = {name for node in network.graph.node for name in node.output}
    plain = [f"/fusions.{i}/fusions.{i}.2/Relu_output_0" for i in range(len(CHANNELS))]
    stored = [f"{name}_DequantizeLinear_Output" for name in plain]
    return [q if q in outputs else p for p, q in zip(plain, stored, strict=True)]


def photographs(folder: Path, labels: Path) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Values of photographs, and the metres of their labels."""
    for path in sorted(labels.iterdir()):
        value = cv2.imread(str(folder / f"{path.stem}.jpg"), cv2.IMREAD_GRAYSCALE)
        label = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        yield value, 0.2 * 60 ** (label.astype(np.float32) / 255)


def pairs(folder: Path, *, held_out: bool | None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Values and metres of pairs 1-1000: of the scenes held out, the others, or (None) all."""
    with (folder / "index.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if int(row["id"]) < PAIRS]
    scenes = held_out_scenes([row["scene"] for row in rows])
    for row in rows:
        if held_out in {None, row["scene"] in scenes}:
            image = cv2.imread(str(folder / "rgb" / f"{row['id']}.jpg"))
            depth = cv2.imread(str(folder / "depth" / f"{row['id']}.png"), cv2.IMREAD_UNCHANGED)
            yield image.max(-1), depth.astype(np.float32) / 1000


def train(head: ErrorHead, sources: Sequence[Samples], steps: int) -> None:
    """Train on equal numbers of each source."""
    optimizer = torch.optim.AdamW(head.parameters(), RATE, weight_decay=0.02)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, steps)
    begin = time.monotonic()
    for step in range(1, steps + 1):
        loss = torch.zeros(())
        for source in sources:
            chosen = torch.randint(len(source), (BATCH,))
            inputs, error = source.batch(chosen, mirrored=step % 2 == 0)
            log_error = head(*inputs)
            loss = loss + (log_error + error / log_error.exp()).mean() / len(sources)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % 100 == 0:
            print(f"step {step}  loss {loss:.3f}  {time.monotonic() - begin:.0f} s", flush=True)


@torch.no_grad()
def measure(head: ErrorHead, samples: Samples) -> tuple[float, float]:
    """Print how well the errors of held-out images are known; returns the line that mends them."""
    head.eval()
    areas, expected, true = [], [], []
    for i in range(len(samples)):
        inputs, _ = samples.batch(torch.tensor([i]))
        size = samples.parts[2].shape[-2:]
        log_error = F.interpolate(head(*inputs), size=size, mode="bilinear").flatten()
        error = (samples.log_m(torch.tensor([i])) - samples.parts[2][i]).flatten().expm1().abs()
        areas.append(sparsification(error, log_error))
        expected.append(log_error)
        true.append(error)
    print(
        f"area under the sparsification curve {np.mean(areas):.3f}, of all images together "
        f"{sparsification(torch.cat(true), torch.cat(expected)):.3f} (random 1, true order 0)"
    )
    log_errors, errors = torch.cat(expected), torch.cat(true)
    order = log_errors.argsort()
    groups = zip(log_errors[order].chunk(40), errors[order].chunk(40), strict=True)
    points = np.array([(x.mean(), y.mean().log()) for x, y in groups])
    slope, offset = np.polyfit(*points.T, 1)
    for low, high in (
        (0.06, 0.08),
        (0.08, 0.1),
        (0.1, 0.13),
        (0.13, 0.16),
        (0.16, 0.2),
        (0.2, 0.25),
    ):
        x = (log_errors * slope + offset).exp()
        inside = (x >= low) & (x < high)
        print(
            f"stated {low:.0%} to {high:.0%}: {inside.float().mean():.1%} of pixels, mean stated "
            f"{x[inside].mean():.3f}, true {errors[inside].mean():.3f}"
        )
    return float(offset), float(slope)


def sparsification(error: Tensor, key: Tensor) -> float:
    """Area between the mean error of the pixels of least key and that of least error.

    It is 0 if the order is right, and 1 if it is a random one.
    """
    counts = torch.arange(1, len(error) + 1)

    def area(order: Tensor) -> float:
        return float((error[order].double().cumsum(0) / counts).mean())

    mean, best = float(error.double().mean()), area(error.argsort())
    return (area(key.argsort()) - best) / (mean - best)


def graft(head: ErrorHead, model: Path, out: Path) -> None:
    """Add a head to a copy of a model, whose depth stays as it is."""
    network = onnx.load(model / "model.onnx")
    names = decoder_maps(network)
    head.eval()
    width, height = 64, 48
    example = [torch.zeros(1, 1, 4 * height, 4 * width), torch.zeros(1, 1, 2 * height, 2 * width)]
    for i, channels in enumerate(CHANNELS):
        scale = 2.0 ** (i - 2)
        example.append(torch.zeros(1, channels, int(height * scale), int(width * scale)))
    names_in = ["image", "raw", *(f"map{i}" for i in range(len(CHANNELS)))]
    batch = {0: "batch", 2: "rows", 3: "columns"}
    path = out / "head.onnx"
    out.mkdir(parents=True, exist_ok=True)
    torch.onnx.export(
        RelativeError(head).eval(),
        tuple(example),
        str(path),
        input_names=names_in,
        output_names=[OUTPUT],
        dynamic_axes=dict.fromkeys((*names_in, OUTPUT), batch),
        opset_version=network.opset_import[0].version,
        dynamo=False,
    )
    part = add_prefix(onnx.load(path), PREFIX, rename_outputs=False)
    path.unlink()
    links = {f"{PREFIX}image": "image", f"{PREFIX}raw": "depth"}
    links |= {f"{PREFIX}map{i}": name for i, name in enumerate(names)}
    for node in part.graph.node:
        node.input[:] = [links.get(name, name) for name in node.input]
    network.graph.node.extend(part.graph.node)
    network.graph.initializer.extend(part.graph.initializer)
    del network.graph.output[:]  # with depth, it would be computed for nobody
    network.graph.output.extend(part.graph.output)
    onnx.checker.check_model(network)
    onnx.save(network, out / "model.onnx")


def write_card(model: Path, out: Path, line: tuple[float, float], steps: int) -> None:
    """Write the card of the network with the head."""
    card = json.loads((model / "card.json").read_text())
    data = (out / "model.onnx").read_bytes()
    summary = (
        f"The relative error that the depth of {card['name']} is expected to have, for --error."
    )
    training = {
        "data": f"NYU Depth v2, labelled pairs 1-{PAIRS}, and photographs with labels",
        "method": "docs/error_head.py: a head on the frozen network, likelihood of Laplace",
        "seed": 0,
        "steps": steps,
        "line": line,
        "network": card["sha256"],
    }
    shared = {name: card[name] for name in ("schema", "version", "license", "input", "onnx")}
    written = {
        **shared,
        "name": out.name,
        "summary": summary,
        "output": {"kind": "relative", "transform": "linear", "scale": 1.0, "shift": 0.0},
        "camera": None,
        "file": "model.onnx",
        "sha256": sha256(data).hexdigest(),
        "bytes": len(data),
        "training": training,
    }
    (out / "card.json").write_text(json.dumps(written, indent=2) + "\n")


def main() -> None:
    """Train a head, measure it or apply the line, and write the model."""
    parser = argparse.ArgumentParser()
    parser.add_argument("model", type=Path)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--photographs", type=Path, required=True)
    parser.add_argument("--labels", type=Path, required=True)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--line", type=float, nargs=2)
    parser.add_argument("--steps", type=int, default=600)
    options = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    torch.manual_seed(0)
    labelled = Samples(options.model, photographs(options.photographs, options.labels))
    labelled.forgive(2 / 3)
    measured = Samples(options.model, pairs(options.data, held_out=None if options.line else False))
    head = ErrorHead(labelled.codec)
    train(head, (labelled, measured), options.steps)
    if options.line:
        head.line = tuple(options.line)
    else:
        head.line = measure(head, Samples(options.model, pairs(options.data, held_out=True)))
        print("--line", *(f"{number:.4f}" for number in head.line))
    graft(head, options.model, options.out)
    torch.save(head.state_dict(), options.out.with_suffix(".pt"))
    write_card(options.model, options.out, head.line, options.steps)


if __name__ == "__main__":
    main()
