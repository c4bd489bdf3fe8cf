"""Networks of Hugging Face's transformers, from configurations without downloads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
import transformers as hf
from run import Authors, Tiny, randomize, sample, spread

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

VIT = {"hidden_size": 48, "num_hidden_layers": 4, "num_attention_heads": 2}
SIZES = [16, 16, 24, 24]
DINO = {
    **VIT,
    "model_type": "dinov2",
    "image_size": 518,
    "patch_size": 14,
    "reshape_hidden_states": False,
    "out_indices": [1, 2, 3, 4],
}
ANYTHING = {
    "backbone_config": DINO,
    "reassemble_hidden_size": 48,
    "neck_hidden_sizes": SIZES,
    "fusion_hidden_size": 16,
}
IMAGENET = {"image_mean": [0.485, 0.456, 0.406], "image_std": [0.229, 0.224, 0.225]}


class Chosen(torch.nn.Module):
    """A network whose named outputs are a tuple."""

    def __init__(self, model: torch.nn.Module, *names: str) -> None:
        super().__init__()
        self.model, self.names = model, names

    def forward(
        self, image: torch.Tensor, known_m: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, ...]:
        """The outputs for (1, 3, H, W), and known depth of a network that takes it."""
        more = {} if known_m is None else {"prompt_depth": known_m}
        output = self.model(pixel_values=image, **more)
        return tuple(getattr(output, name) for name in self.names)


def build(card: str) -> Authors:
    """The network of a card."""
    family = next(name for name in FAMILIES if card.startswith(name))
    return FAMILIES[family](card)


def processing(side: int) -> dict[str, Any]:
    """Options of a processor of Depth Anything."""
    size = {"size": {"height": side, "width": side}, "keep_aspect_ratio": True}
    return {**size, "ensure_multiple_of": 14, **IMAGENET}


def anything(max_m: float | None = None) -> Chosen:
    """Depth Anything, for metres up to some or relative."""
    kind = "relative" if max_m is None else "metric"
    config = hf.DepthAnythingConfig(**ANYTHING, depth_estimation_type=kind, max_depth=max_m or 1)
    return Chosen(randomize(hf.DepthAnythingForDepthEstimation(config)), "predicted_depth")


def of_anything(card: str) -> Authors:
    """Depth Anything V1, and Distill-Any-Depth."""
    del card
    model = anything().model
    return of_hub(model, hf.DPTImageProcessorPil(**processing(518)), model.head.conv3)


def of_prompt_depth_anything(card: str) -> Authors:
    """Prompt Depth Anything, with known depth of the lidar of a phone."""
    del card
    config = hf.PromptDepthAnythingConfig(**ANYTHING, depth_estimation_type="metric")
    model = randomize(hf.PromptDepthAnythingForDepthEstimation(config))
    processor = hf.PromptDepthAnythingImageProcessorPil(**processing(756))
    authors = of_hub(model, processor, model.head.conv3, mean=0.5)
    return authors._replace(known="prompt_depth", tiny=TinyKnown(1))


class TinyKnown(Tiny):
    """A map that known depth is added to."""

    def forward(self, image: torch.Tensor, known_m: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Metres of (1, 3, H, W) and (1, 1, h, w)."""
        (depth,) = super().forward(image)
        size = depth.shape[-2:]
        return (depth + torch.nn.functional.interpolate(known_m, size=size, mode="bilinear")[0],)


def of_dpt(card: str) -> Authors:
    """MiDaS 3.0, which is of square images there."""
    del card
    config = hf.DPTConfig(
        **VIT,
        intermediate_size=96,
        neck_hidden_sizes=SIZES,
        fusion_hidden_size=16,
        image_size=384,
        backbone_out_indices=[0, 1, 2, 3],
    )
    model = randomize(hf.DPTForDepthEstimation(config))
    return of_hub(model, hf.DPTImageProcessorPil(), model.head.head[4])


def of_glpn(card: str) -> Authors:
    """GLPN."""
    config = hf.GLPNConfig(
        hidden_sizes=[16, 16, 32, 32],
        num_attention_heads=[1, 1, 2, 2],
        depths=[1, 1, 1, 1],
        decoder_hidden_size=16,
        max_depth=10 if card.endswith("nyu") else 80,
    )
    model = randomize(hf.GLPNForDepthEstimation(config))
    return of_hub(model, hf.GLPNImageProcessorPil(), model.head.head[2], mean=0)


def of_zoe(card: str) -> Authors:
    """ZoeDepth."""
    del card
    beit = {
        **VIT,
        "model_type": "beit",
        "image_size": 384,
        "intermediate_size": 96,
        "use_relative_position_bias": True,
        "reshape_hidden_states": False,
        "out_features": ["stage1", "stage2", "stage3", "stage4"],
    }
    bins = {"n_bins": 64, "min_depth": 1e-3, "max_depth": 10.0, "name": "nyu"}
    config = hf.ZoeDepthConfig(
        backbone_config=beit,
        neck_hidden_sizes=SIZES,
        fusion_hidden_size=32,
        bottleneck_features=32,
        bin_configurations=[bins],
        bin_embedding_dim=32,
        bin_centers_type="softplus",
    )
    processor = hf.ZoeDepthImageProcessor(do_pad=False, ensure_multiple_of=32)
    model = randomize(hf.ZoeDepthForDepthEstimation(config))
    return of_hub(model, processor, None, sizes="source_sizes")


def of_depth_pro(card: str) -> Authors:
    """Depth Pro; its image is 1536 a side, cut into 35 of 384."""
    del card
    dino = {
        "model_type": "dinov2",
        "hidden_size": 24,
        "num_hidden_layers": 2,
        "num_attention_heads": 2,
        "image_size": 384,
        "patch_size": 16,
    }
    config = hf.DepthProConfig(
        fusion_hidden_size=16,
        intermediate_hook_ids=[1, 0],
        intermediate_feature_dims=[16, 16],
        scaled_images_feature_dims=[16, 16, 16],
        use_fov_model=True,
        **dict.fromkeys(("image_model_config", "patch_model_config", "fov_model_config"), dino),
    )
    model = randomize(hf.DepthProForDepthEstimation(config))
    fov = last_convolution(model.fov_model.head)
    fov.weight *= 0.1
    fov.bias.fill_(60.0)
    processor = hf.DepthProImageProcessor()
    authors = of_hub(model, processor, last_convolution(model.head), mean=0.5, deviation=0.1)
    outputs = ("predicted_depth", "field_of_view")
    return authors._replace(network=Chosen(model, *outputs), outputs=outputs, tiny=TinyView(2))


def last_convolution(head: torch.nn.Module) -> torch.nn.Conv2d:
    """The last one of a head."""
    return [layer for layer in head.modules() if isinstance(layer, torch.nn.Conv2d)][-1]


class TinyView(Tiny):
    """A map and a field of view in degrees."""

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """(1, H, W) and (1,)."""
        depth, other = super().forward(image)
        return depth, 50 + 10 * other.mean(dim=(1, 2))


def of_hub(
    model: torch.nn.Module,
    processor: Any,  # noqa: ANN401 - theirs
    last: torch.nn.Module | None,
    *,
    mean: float = 4,
    deviation: float = 1,
    sizes: str = "target_sizes",
) -> Authors:
    """A network with its processor; the outputs of its last layer get a mean and a deviation."""

    def prepare(rgb: np.ndarray) -> torch.Tensor:
        return processor(images=rgb, return_tensors="pt")["pixel_values"]

    def finish(outputs: tuple[torch.Tensor, ...], rgb: np.ndarray) -> dict[str, Any]:
        output = hf.models.depth_pro.modeling_depth_pro.DepthProDepthEstimatorOutput(
            predicted_depth=outputs[0], field_of_view=outputs[1] if len(outputs) > 1 else None
        )
        (end,) = processor.post_process_depth_estimation(output, **{sizes: [rgb.shape[:2]]})
        return {"full": end["predicted_depth"]}

    if last is not None:
        image = prepare(sample())
        spread(last, lambda: model(image), mean, deviation)
    return Authors(Chosen(model, "predicted_depth"), ("predicted_depth",), prepare, finish)


FAMILIES: dict[str, Callable[[str], Authors]] = {
    "depth-anything-v1": of_anything,
    "distill-any-depth": of_anything,
    "promptda": of_prompt_depth_anything,
    "midas-dpt-large": of_dpt,
    "glpn": of_glpn,
    "zoedepth": of_zoe,
    "depth-pro": of_depth_pro,
}
