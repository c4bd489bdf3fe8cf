"""Their side of ``verify_cards.py``, run where the authors' package is installed.

``python run.py MODULE FOLDER CARD ...`` builds the network of each card with random weights and
runs the authors' own code on each FOLDER/*.png. It writes FOLDER/CARD/*.npz with ``raw``, the
network's output; ``full``, depth at the image's size, where they enlarge it; and what else its
module gives; and the network to FOLDER/CARD/HEIGHTxWIDTH.onnx for each size of its input. It
writes to FOLDER/CARD/kept.npz what tests keep: a small image, a network of few weights, and the
authors' depth with it.
"""

from __future__ import annotations

import importlib
import sys
import traceback
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
import torch

if TYPE_CHECKING:
    from collections.abc import Callable

    #: maps the network's outputs and (H, W, 3) to arrays to compare with
    Finish = Callable[[tuple[torch.Tensor, ...], np.ndarray], dict[str, Any]]

SEED = 20261125


class Authors(NamedTuple):
    """A network and the authors' way from an image to depth."""

    network: torch.nn.Module  #: maps (1, 3, H, W) to its outputs, the first of which is the map
    outputs: tuple[str, ...]  #: their names
    #: maps (H, W, 3) uint8 RGB to the network's input
    prepare: Callable[[np.ndarray], torch.Tensor]
    finish: Finish
    #: a network of few weights with the same outputs, for the tests; None for plain maps
    tiny: torch.nn.Module | None = None
    is_finished_alone: bool = True  #: whether ``finish`` needs nothing but the outputs
    known: str = ""  #: name of the network's second input, known depth; none if empty


def main(module: str, folder: str, *cards: str) -> None:
    """Write networks and depth."""
    declare_torchvision()
    torch.set_num_threads(1)
    build = importlib.import_module(module).build
    images = sorted(Path(folder).glob("*.png"))
    with torch.no_grad():
        for card in cards:
            where = Path(folder) / card
            where.mkdir()
            torch.manual_seed(SEED)
            try:
                authors = build(card)
                run(authors, images, where)
                keep(authors, where / "kept.npz")
            except Exception:  # noqa: BLE001 - the other cards are still compared
                traceback.print_exc()


def run(authors: Authors, images: list[Path], where: Path) -> None:
    """Write the network and depth of one card."""
    for path in images:
        rgb = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
        image = authors.prepare(rgb)
        more = [known_depth(*KNOWN_SIZE)] if authors.known else []
        outputs = authors.network(image, *more)
        outputs = outputs if isinstance(outputs, tuple) else (outputs,)
        arrays = {"raw": outputs[0], **authors.finish(outputs, rgb)}
        arrays |= {"known": more[0][0, 0]} if more else {}
        np.savez(where / f"{path.stem}.npz", **{k: np.asarray(v) for k, v in arrays.items()})
        file = where / "{}x{}.onnx".format(*image.shape[-2:])
        if not file.exists():
            export(authors, (image, *more), file)


KNOWN_SIZE = 256, 192
"""Columns and rows of known depth."""


def known_depth(columns: int, rows: int) -> torch.Tensor:
    """A slope with steps in metres, (1, 1, rows, columns)."""
    y, x = np.mgrid[:rows, :columns]
    metres = 1 + x / columns + y / rows / 2 + (x * 4 // columns + y * 3 // rows) % 2
    return torch.from_numpy(metres.astype(np.float32))[None, None]


KEPT_STEP = 24
"""Every so many pixels of a map at the network's size are kept."""


class Tiny(torch.nn.Module):
    """Maps of a few weights, (1, H, W) each."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.mix = torch.nn.Conv2d(3, count, 5, stride=2, padding=2)
        torch.nn.init.normal_(self.mix.weight, std=0.3)
        torch.nn.init.constant_(self.mix.bias, 0.3)

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Positive maps of (1, 3, H, W), at half its size."""
        maps = torch.nn.functional.softplus(self.mix(image))
        return tuple(maps[:, i] for i in range(maps.shape[1]))


def keep(authors: Authors, file: Path) -> None:
    """Write what tests keep of a card."""
    rows, columns = np.mgrid[:33, :47].astype(np.float32)
    planes = [np.sin(columns / 5) * 90 + 120, rows * 7, (rows * columns) % 97 + 60]
    rgb = np.stack(planes, -1).astype(np.uint8)
    tiny = (authors.tiny or Tiny(len(authors.outputs))).eval()
    image = authors.prepare(rgb)
    more = [known_depth(23, 16)] if authors.known else []
    outputs = tiny(image, *more)
    arrays = {"raw": outputs[0]} | (
        authors.finish(outputs, rgb) if authors.is_finished_alone else {}
    )
    arrays |= {"known": more[0][0, 0]} if more else {}
    thinned = {name: np.asarray(value) for name, value in arrays.items()}
    for name in {"raw", "ground", "metres"} & thinned.keys():
        thinned[name] = thinned[name].reshape(thinned[name].shape[-2:])[::KEPT_STEP, ::KEPT_STEP]
    graph = BytesIO()
    only = authors._replace(network=tiny)
    export(only, (image, *more), graph, dynamic_axes={"image": [2, 3]})
    onnx = np.frombuffer(graph.getvalue(), np.uint8)
    np.savez_compressed(file, picture=rgb, onnx=onnx, size=image.shape[-2:], **thinned)


def export(
    authors: Authors,
    inputs: tuple[torch.Tensor, ...],
    file: Path | BytesIO,
    **options: Any,  # noqa: ANN401
) -> None:
    """Write the network for one size."""
    torch.onnx.export(
        authors.network.eval(),
        inputs,
        str(file) if isinstance(file, Path) else file,
        input_names=["image", authors.known][: len(inputs)],
        output_names=list(authors.outputs),
        opset_version=18,
        dynamo=False,
        **options,
    )


def declare_torchvision() -> None:
    """Let the Python part of torchvision load.

    PyPI's is built for CUDA, so beside torch for CPUs its compiled part is missing.
    """
    vision = torch.library.Library("torchvision", "FRAGMENT")
    for name in ("nms", "qnms"):
        vision.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
    globals()["_vision"] = vision  # the declaration lives as long as this object


def randomize(network: torch.nn.Module) -> torch.nn.Module:
    """Random weights that keep the variance from layer to layer, so that an image is seen."""
    for name, values in network.named_parameters():
        if values.ndim > 1 and "pos" not in name and "token" not in name:
            torch.nn.init.normal_(values, std=values[0].numel() ** -0.5)
        elif values.ndim > 1:
            torch.nn.init.normal_(values, std=0.5)
        elif "bias" in name:
            torch.nn.init.normal_(values, std=0.1)
        else:
            torch.nn.init.uniform_(values, 0.5, 1.5)
    return network.eval()


def spread(last: torch.nn.Module, run: Callable[[], object], mean: float, deviation: float) -> None:
    """Rescale the last layer, so that ``run()`` gives it outputs of this mean and deviation."""
    recorded: list[torch.Tensor] = []
    hook = last.register_forward_hook(lambda _module, _args, out: recorded.append(out))
    run()
    hook.remove()
    values = recorded[-1]
    factor = deviation / values.std()
    last.weight *= factor
    last.bias.copy_((last.bias - values.mean()) * factor + mean)


def settle(network: torch.nn.Module, image: torch.Tensor) -> None:
    """Take statistics of batch normalization from an image: without them, values only grow."""
    for norm in network.modules():
        if isinstance(norm, torch.nn.BatchNorm2d):
            norm.momentum = 1.0
    network.train()(torch.cat([image, image.flip(3)]))
    network.eval()


def enlarge(mode: str, *, align_corners: bool) -> Finish:
    """The end of an authors' code that enlarges the map to the image's size."""

    def finish(outputs: tuple[torch.Tensor, ...], rgb: np.ndarray) -> dict[str, Any]:
        maps = outputs[0].reshape(1, 1, *outputs[0].shape[-2:])
        full = torch.nn.functional.interpolate(
            maps, rgb.shape[:2], mode=mode, align_corners=align_corners
        )
        return {"full": full[0, 0]}

    return finish


def sample(seed: int = 0) -> np.ndarray:
    """A small image, (H, W, 3) uint8."""
    return np.random.default_rng(seed).integers(0, 256, (120, 160, 3), np.uint8)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    sys.modules["run"] = sys.modules["__main__"]
    main(*sys.argv[1:])
