"""Draw docs/generator.svg: the paper's generator (its Fig. 1), from the network itself.

Run ``python docs/draw_generator.py`` with the ``train`` and ``plot`` extras.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import torch
from matplotlib import pyplot as plt
from matplotlib.patches import FancyArrowPatch, Rectangle
from torch import Tensor

from depthcli.lab.training.config import GeneratorConfig
from depthcli.lab.training.networks.resnet import ResnetGenerator

SIZE_PX = 256
COLOURS = {"input": "#e8e8e8", "conv": "#9ecae1", "block": "#fdd0a2", "up": "#a1d99b"}


class Stage(NamedTuple):
    """A feature map as it is drawn: what made it, its channels and its side in pixels."""

    name: str
    kind: str
    channels: int
    side_px: int


def stages(network: ResnetGenerator) -> list[Stage]:
    """The feature maps of one pass, measured."""
    named = {
        "stem": ("7×7", "conv"),
        "down1": ("3×3, ½", "conv"),
        "down2": ("3×3, ½", "conv"),
        **{f"blocks.{i}": (f"block {i + 1}", "block") for i in range(len(network.blocks))},
        "up1": ("3×3, ×2", "up"),
        "up2": ("3×3, ×2", "up"),
        "head": ("depth: 7×7, tanh", "input"),
    }
    layers = [Stage("V of HSV", "input", 1, SIZE_PX)]
    for name, (label, kind) in named.items():

        def keep(
            _module: object, _inputs: object, map_: Tensor, what: tuple[str, str] = (label, kind)
        ) -> None:
            layers.append(Stage(*what, map_.shape[1], map_.shape[-1]))

        network.get_submodule(name).register_forward_hook(keep)
    with torch.inference_mode():
        network(torch.zeros(1, 1, SIZE_PX, SIZE_PX))
    return layers


def draw(found: list[Stage], taps: dict[int, str], path: Path) -> None:
    """One box a feature map: as high as its side, as wide as its channels ask."""
    figure, axes = plt.subplots(figsize=(13, 4.2))
    left, middles = 0.0, []
    for number, stage in enumerate(found):
        height, width = stage.side_px / SIZE_PX, 0.10 + stage.channels / 900
        axes.add_patch(
            Rectangle(
                (left, -height / 2), width, height, fc=COLOURS[stage.kind], ec="#444444", lw=0.8
            )
        )
        middle = left + width / 2
        middles.append((middle, height / 2))
        axes.text(
            middle, height / 2 + 0.03, stage.name, ha="center", va="bottom", fontsize=8, rotation=60
        )
        axes.text(
            middle,
            -height / 2 - 0.03,
            f"{stage.channels}\n{stage.side_px}²",
            ha="center",
            va="top",
            fontsize=7,
        )
        if number in taps:
            axes.text(
                middle, 0, taps[number], ha="center", va="center", fontsize=9, color="#b30000"
            )
        left += width + 0.16
    first, last = middles[1], middles[-2]
    axes.add_patch(
        FancyArrowPatch(
            (first[0], first[1] + 0.33),
            (last[0], last[1] + 0.33),
            connectionstyle="arc3,rad=-0.12",
            arrowstyle="-|>",
            mutation_scale=12,
            color="#444444",
        )
    )
    axes.text(
        (first[0] + last[0]) / 2,
        1.22,
        "last residual connection: features after the first layer",
        ha="center",
        fontsize=8,
    )
    axes.text(
        0,
        -0.92,
        "● patch features of the contrastive loss (eq. 4), each through two linear layers",
        fontsize=8,
        color="#b30000",
    )
    axes.set(xlim=(-0.1, left), ylim=(-1.0, 1.4))
    axes.axis("off")
    figure.savefig(path, bbox_inches="tight", metadata={"Date": None})


def main() -> None:
    """Draw it as the paper has it: width 64, nine blocks."""
    mpl.rcParams |= {"svg.hashsalt": "depthcli", "svg.fonttype": "none"}
    layers = stages(ResnetGenerator(GeneratorConfig()))
    names = ["input", "stem", "down1", "down2", "block1", "block2", "block3", "block4", "block5"]
    taps = {names.index(tap): "●" for tap in ResnetGenerator.TAPS}
    draw(layers, taps, Path(__file__).with_name("generator.svg"))


if __name__ == "__main__":
    main()
