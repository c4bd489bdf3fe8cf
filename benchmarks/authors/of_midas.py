"""MiDaS 3: the authors' preprocessing and end by controlnet-aux, the networks by transformers."""

from __future__ import annotations

import importlib
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import geffnet
import of_transformers
import torch
import transformers as hf
from run import Authors, enlarge, randomize, sample, settle, spread

if TYPE_CHECKING:
    import numpy as np


# The authors' repository lies inside the package, whose own __init__ imports much else.
sys.path.insert(0, str(Path(find_spec("controlnet_aux").origin).parent / "midas"))
from midas.transforms import NormalizeImage, PrepareForNet, Resize

VIT = {**of_transformers.VIT, "intermediate_size": 96}
STAGES = ["stage1", "stage2", "stage3", "stage4"]
NECK = {"neck_hidden_sizes": [16, 16, 24, 24], "fusion_hidden_size": 16}


def build(card: str) -> Authors:
    """A network of the card's kind, 48 channels wide, and the authors' sizes."""
    if card == "midas-small-torch":
        return small()
    size = int(card.rpartition("-")[2])
    if "beit" in card:
        beit = hf.BeitConfig(
            **VIT,
            image_size=size,
            use_relative_position_bias=True,
            reshape_hidden_states=False,
            out_features=STAGES,
        )
        config = hf.DPTConfig(backbone_config=beit, **NECK, hidden_size=48)
    else:
        swin = hf.Swinv2Config(
            image_size=size,
            embed_dim=24,
            depths=[1, 1, 1, 1],
            num_heads=[1, 2, 2, 2],
            window_size=16,
            out_features=STAGES,
        )
        config = hf.DPTConfig(
            backbone_config=swin,
            neck_hidden_sizes=[24, 48, 96, 192],
            fusion_hidden_size=16,
            hidden_size=192,
        )
    model = randomize(hf.DPTForDepthEstimation(config))
    keeps = "swin2" not in card
    processed = processing(size, "minimal", [0.5] * 3, [0.5] * 3, keeps_aspect=keeps)
    example = processed[0](sample())
    spread(model.head.head[4], lambda: model(example), 4, 1)
    return Authors(
        of_transformers.Chosen(model, "predicted_depth"), ("predicted_depth",), *processed
    )


def small() -> Authors:
    """MiDaS v2.1 small, with its encoder from the package geffnet."""
    torch.hub.load = lambda _repository, name, **options: geffnet.create_model(
        name, pretrained=False, exportable=options["exportable"]
    )
    midas_net = importlib.import_module("midas.midas_net_custom")
    model = randomize(midas_net.MidasNet_small(exportable=True))
    processed = processing(256, "upper_bound", *of_transformers.IMAGENET.values())
    example = processed[0](sample())
    settle(model, example)
    spread(model.scratch.output_conv[4], lambda: model(example), 4, 1)
    return Authors(model, ("depth",), *processed)


def processing(
    size: int, method: str, mean: list[float], std: list[float], *, keeps_aspect: bool = True
) -> tuple[Any, Any]:
    """The authors' preprocessing as in their ``model_loader.py``, and the end of ``run.py``."""
    resize = Resize(
        size,
        size,
        resize_target=None,
        keep_aspect_ratio=keeps_aspect,
        ensure_multiple_of=32,
        resize_method=method,
        image_interpolation_method=cv2.INTER_CUBIC,
    )
    normalize, last = NormalizeImage(mean, std), PrepareForNet()

    def prepare(rgb: np.ndarray) -> torch.Tensor:
        pixels = last(normalize(resize({"image": rgb / 255.0})))["image"]
        return torch.from_numpy(pixels)[None]

    return prepare, enlarge("bicubic", align_corners=False)
