"""Depth Anything 3, by the package depth-anything-3."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import torch
from addict import Dict
from depth_anything_3.model import cam_dec, da3, dpt, dualdpt
from depth_anything_3.model.dinov2 import dinov2, vision_transformer
from depth_anything_3.utils.alignment import apply_metric_scaling
from depth_anything_3.utils.io.input_processor import InputProcessor
from run import Authors, randomize, sample, spread

FOCAL_PX = 900.0
CHANNELS = {"features": 16, "out_channels": [16, 16, 24, 24]}


def _pairs(*axes: torch.Tensor) -> torch.Tensor:
    """``torch.cartesian_prod``, which torch cannot export."""
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes))


torch.cartesian_prod = _pairs


class OneView(torch.nn.Module):
    """The network for single images, as its exports have it."""

    def __init__(self, model: torch.nn.Module, *, has_sky: bool) -> None:
        super().__init__()
        self.model, self.has_sky = model, has_sky

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Depth, and sky where there is a head for it, (1, H, W), of (1, 3, H, W)."""
        height, width = image.shape[-2:]
        features, _ = self.model.backbone(image[:, None], export_feat_layers=[])
        outputs = self.model.head(features, height, width, patch_start_idx=0)
        return (outputs.depth[:, 0], *([outputs.sky[:, 0]] if self.has_sky else []))


def build(card: str) -> Authors:
    """The network with 4 layers, 48 channels wide."""
    has_sky = card.endswith(("mono", "metric"))
    small = partial(
        vision_transformer.DinoVisionTransformer, embed_dim=48, depth=4, num_heads=2, block_chunks=0
    )
    dinov2.vit_small = small
    alternates = -1 if has_sky else 2
    net = dinov2.DinoV2(
        "vits", [0, 1, 2, 3], alternates, alternates, alternates, cat_token=not has_sky
    )
    if has_sky:
        model = da3.DepthAnything3Net(net, dpt.DPT(48, output_dim=1, **CHANNELS))
    else:
        head = dualdpt.DualDPT(96, output_dim=2, **CHANNELS)
        model = da3.DepthAnything3Net(
            net, head, cam_dec=cam_dec.CameraDec(96), cam_enc=torch.nn.Identity()
        )
    randomize(model)
    processor = InputProcessor()

    def prepare(rgb: np.ndarray) -> torch.Tensor:
        return processor([rgb], sequential=True)[0]

    example = prepare(sample())[None]
    last = model.head.scratch.output_conv2
    layers = [module for module in last.modules() if isinstance(module, torch.nn.Conv2d)]
    spread(layers[-1], lambda: model(example), 1, 0.3)
    if has_sky:
        spread(model.head.scratch.sky_output_conv2[2], lambda: model(example), 0.25, 0.1)

    def finish(outputs: tuple[torch.Tensor, ...], rgb: np.ndarray) -> dict[str, Any]:
        """Depth without sky, at the network's size: the authors do not enlarge."""
        if not has_sky:
            return {}
        theirs = model._process_mono_sky_estimation(  # noqa: SLF001 - their step
            Dict(depth=outputs[0][None].clone(), sky=outputs[1][None])
        )
        ground = outputs[1][0].numpy() < 0.3
        raw = np.where(ground, theirs.depth[0, 0].numpy(), np.nan)
        if not card.endswith("metric"):
            return {"raw": raw, "ground": ground}
        camera = np.diag([FOCAL_PX, FOCAL_PX, 1.0])[None]
        _, _, scaled = processor([rgb], None, camera, sequential=True)
        metres = apply_metric_scaling(torch.tensor(raw)[None, None], scaled[None])
        return {"raw": raw, "ground": ground, "focal_px": FOCAL_PX, "metres": metres[0, 0]}

    outputs = ("depth", "sky") if has_sky else ("depth",)
    return Authors(OneView(model, has_sky=has_sky), outputs, prepare, finish)
