"""Depth Anything V2 as in the authors' repository, by the package jkp-depth-anything-v2."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import cv2
import of_transformers
from depth_anything_v2 import dinov2, dpt
from run import Authors, enlarge, randomize, sample, spread

if TYPE_CHECKING:
    import torch


def build(card: str) -> Authors:
    """The network with 4 layers, 48 channels wide; one for metres is that of transformers."""
    blocks = partial(dinov2.Block, attn_class=dinov2.MemEffAttention)
    sizes = {"img_size": 518, "patch_size": 14, "embed_dim": 48, "depth": 4, "num_heads": 2}
    encoder = dinov2.DinoVisionTransformer(
        **sizes, block_fn=blocks, init_values=1.0, block_chunks=0, interpolate_offset=0.1
    )
    dpt.DINOv2 = lambda model_name: encoder  # noqa: ARG005 - the authors' signature
    model = dpt.DepthAnythingV2("vits", features=16, out_channels=[16, 16, 24, 24])
    model.intermediate_layer_idx = {"vits": [0, 1, 2, 3]}
    randomize(model)
    spread(model.depth_head.scratch.output_conv2[2], lambda: model.infer_image(sample()), 4, 1)

    network: torch.nn.Module = model
    if "metric" in card:
        network = of_transformers.anything(20 if "indoor" in card else 80)
        example = model.image2tensor(sample())[0]
        spread(network.model.head.conv3, lambda: network(example), 0, 1)
    return Authors(
        network,
        ("depth",),
        lambda rgb: model.image2tensor(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))[0],
        enlarge("bilinear", align_corners=True),  # as at the end of ``infer_image``
    )
