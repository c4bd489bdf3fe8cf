"""Ultralytics' depth networks, by the package ultralytics (AGPL: run here only)."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import torch
from run import Authors, randomize, sample, settle, spread
from ultralytics import YOLO
from ultralytics.data.augment import LetterBox

SIDE = 640


class Exported(torch.nn.Module):
    """The network as their export has it: its depth at the size of its input."""

    def __init__(self, model: torch.nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Depth, (1, 1, H, W), of (1, 3, H, W)."""
        head = self.model.model[-1]
        head.export = True
        depth = self.model(image)
        head.export = False
        return depth


def build(card: str) -> Authors:
    """The smallest network of the family, of random weights."""
    del card
    yolo = YOLO("yolo26n-depth.yaml")
    model = randomize(yolo.model)

    def prepare(rgb: np.ndarray) -> torch.Tensor:
        """Their ``pre_transform`` and ``preprocess``."""
        letterbox = LetterBox((SIDE, SIDE), auto=False, scale_fill=True, stride=32)
        pixels = letterbox(image=cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))[..., ::-1]
        planes = torch.from_numpy(np.ascontiguousarray(pixels.transpose(2, 0, 1)))
        return planes[None].float().div_(255)

    image = prepare(sample())
    settle(model, image)
    spread(model.model[-1].head[-1], lambda: model(image), 1, 0.3)

    def finish(outputs: tuple[torch.Tensor, ...], rgb: np.ndarray) -> dict[str, Any]:
        """The whole of their ``predict``."""
        del outputs
        bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
        (results,) = yolo.predict(bgr, imgsz=SIDE, verbose=False, device="cpu")
        depth = results.depth
        return {"full": np.asarray(getattr(depth, "data", depth)).squeeze()}

    return Authors(Exported(model), ("depth",), prepare, finish, is_finished_alone=False)
