"""MoGe-2, by the package dlr-moge."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import torch
from moge.model import v2
from moge.model.dinov2.hub import backbones
from moge.model.dinov2.layers import MemEffAttention, NestedTensorBlock
from moge.model.dinov2.models.vision_transformer import DinoVisionTransformer
from moge.utils.geometry_torch import normalized_view_plane_uv
from run import Authors, Tiny, randomize
from scipy import optimize

if TYPE_CHECKING:
    import numpy as np

TOKENS = 400
LEVELS = 5
WIDE = 32
OUTPUTS = ("points", "mask", "metric_scale")


def _settled(*arguments: Any, **options: Any) -> Any:  # noqa: ANN401 - theirs
    """Their least squares to the end: their tolerance of 1e-3 stops short of the least."""
    return _least_squares(*arguments, **{**options, "ftol": 1e-12, "xtol": 1e-12})


_least_squares, optimize.least_squares = optimize.least_squares, _settled


def encoder(**_: object) -> torch.nn.Module:
    """DINOv2 with 2 layers, 48 channels wide."""
    block = partial(NestedTensorBlock, attn_class=MemEffAttention)
    sizes = {"img_size": 518, "patch_size": 14, "embed_dim": 48, "depth": 2, "num_heads": 2}
    return DinoVisionTransformer(**sizes, block_fn=block, init_values=1.0, block_chunks=0)


def points_on_rays(rough: torch.Tensor) -> torch.Tensor:
    """Raw points (N, 3, h, w) near those of a camera, whatever random weights give."""
    height, width = rough.shape[-2:]
    rays = normalized_view_plane_uv(width, height).permute(2, 0, 1)[None] / 1.2
    z = 0.3 * torch.tanh(rough[:, 2:]) + 0.7
    return torch.cat([rays + 0.01 * torch.tanh(rough[:, :2]), z], dim=1)


class OnRays(torch.nn.Module):
    """A head of points near those of a camera."""

    def __init__(self, head: torch.nn.Module) -> None:
        super().__init__()
        self.head = head

    def forward(self, features: list[torch.Tensor]) -> list[torch.Tensor]:
        """Points of the last level."""
        return [points_on_rays(self.head(features)[-1])]


class Exported(torch.nn.Module):
    """The network for a fixed number of tokens, as its exports have it."""

    def __init__(self, model: torch.nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Points (1, H, W, 3), mask (1, H, W) and scale (1,)."""
        outputs = self.model(image, TOKENS)
        return tuple(outputs[name] for name in OUTPUTS)


class TinyPoints(Tiny):
    """Points near those of a camera, a mask and a scale."""

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Outputs at the size of the image."""
        maps = self.mix(image)
        maps = torch.nn.functional.interpolate(maps, scale_factor=2.0, mode="nearest")
        height, width = image.shape[-2:]
        maps = maps[..., :height, :width]
        raw = points_on_rays(maps[:, :3]).permute(0, 2, 3, 1)
        z = raw[..., 2:].exp()
        points = torch.cat([raw[..., :2] * z, z], dim=-1)
        return points, maps[:, 3].sigmoid(), 1 + maps.mean(dim=(1, 2, 3)) ** 2


def build(card: str) -> Authors:
    """The network with small layers."""
    del card
    backbones.dinov2_vits14 = encoder
    stack = {"dim_res_blocks": [WIDE] * LEVELS, "resamplers": ["bilinear"] * (LEVELS - 1)}
    head = {"dim_in": [None] * LEVELS, **stack}
    model = v2.MoGeModel(
        encoder={"backbone": "dinov2_vits14", "intermediate_layers": 2, "dim_out": WIDE},
        neck={"dim_in": [WIDE + 2, 2, 2, 2, 2], "dim_out": [None] * LEVELS, **stack},
        points_head={**head, "dim_out": [None] * (LEVELS - 1) + [3]},
        mask_head={**head, "dim_out": [None] * (LEVELS - 1) + [1]},
        scale_head={"dims": [48, 16, 1]},
        remap_output="exp",
    )
    randomize(model)
    model.points_head = OnRays(model.points_head)
    model.onnx_compatible_mode = True

    def prepare(rgb: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(rgb).permute(2, 0, 1)[None].float() / 255

    def finish(outputs: tuple[torch.Tensor, ...], rgb: np.ndarray) -> dict[str, Any]:
        """The rest of ``infer``, by the authors' code on these outputs."""
        copies = dict(zip(OUTPUTS, (output.clone() for output in outputs), strict=True))
        model.forward = lambda image, num_tokens: copies  # noqa: ARG005 - theirs
        result = model.infer(prepare(rgb), TOKENS, use_fp16=False)
        del model.forward
        raw, hfov_rad = outputs[0][0, ..., 2], 2 * torch.atan(0.5 / result["intrinsics"][0, 0, 0])
        maps = {"raw": raw, "full": result["depth"][0], "has": result["mask"][0]}
        return {**maps, "hfov_deg": torch.rad2deg(hfov_rad)}

    return Authors(Exported(model), OUTPUTS, prepare, finish, TinyPoints(4))
