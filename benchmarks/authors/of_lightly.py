"""LightlyTrain's depth networks, by the package lightly-train (AGPL: run here only)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from lightly_train._task_models.depth_estimation import task_model
from run import Authors, randomize, sample, spread

FOCAL_PX = 900.0


def build(card: str) -> Authors:
    """The network with its own sizes, of random weights."""
    name = "dinov3/" + card.removeprefix("lightly-")
    model = randomize(task_model.DepthAnythingDepthEstimation(model_name=name, load_weights=False))

    def prepare(rgb: np.ndarray) -> torch.Tensor:
        image, _ = model.preprocess_image(torch.from_numpy(rgb).permute(2, 0, 1))
        return model.preprocess_batch([image])

    example = prepare(sample())
    last = model.decoder.scratch
    spread(last.output_conv2[-1], lambda: model(example), 1, 0.3)
    spread(last.sky_output_conv2[-1], lambda: model(example), 0, 1)

    def finish(outputs: tuple[torch.Tensor, ...], rgb: np.ndarray) -> dict[str, Any]:
        """Their depth, without sky, whose depth they set to the farthest of the image."""
        ground = outputs[1].numpy().reshape(outputs[1].shape[-2:]) < 0.3
        raw = outputs[0].reshape(ground.shape)
        facts = {"orig_h": rgb.shape[0], "orig_w": rgb.shape[1]}
        arrays = {"raw": np.where(ground, raw.numpy(), np.nan), "ground": ground}
        if "metric" in card:
            camera = torch.diag(torch.tensor([FOCAL_PX, FOCAL_PX, 1.0]))
            side = model.image_size
            facts["focal"] = task_model._processed_focal_length(  # noqa: SLF001 - their step
                intrinsics=camera,
                orig_h=rgb.shape[0],
                orig_w=rgb.shape[1],
                proc_h=side,
                proc_w=side,
            )
            arrays |= {"focal_px": FOCAL_PX}
        maps = tuple(output.reshape(1, 1, *ground.shape) for output in outputs)
        (full,) = model.postprocess(maps, [facts])
        enlarged = torch.nn.functional.interpolate(
            torch.tensor(ground, dtype=torch.float32)[None, None], rgb.shape[:2], mode="bilinear"
        )
        return arrays | {"full": full, "at": enlarged[0, 0] == 1}

    return Authors(model, ("depth", "sky"), prepare, finish)
