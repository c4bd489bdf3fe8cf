"""ZipDepth, by the port in the package libreyolo, which loads the authors' weights."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import torch
from run import Authors, enlarge, randomize, sample, settle, spread

if TYPE_CHECKING:
    import numpy as np


# The package's own __init__ imports all of its fifty families.
_ROOT = Path(find_spec("libreyolo").origin).parent
for _name in ("libreyolo.models", "libreyolo.models.zipdepth"):
    sys.modules[_name] = ModuleType(_name)
    sys.modules[_name].__path__ = [str(_ROOT.joinpath(*_name.split(".")[1:]))]

from libreyolo.models.zipdepth import nn, utils  # noqa: E402


def build(card: str) -> Authors:
    """The network with its own sizes."""
    del card
    model = randomize(nn.LibreZipDepthNet("b"))

    def prepare(rgb: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(utils.preprocess_numpy(rgb)[0])[None]

    image = prepare(sample())
    settle(model, image)
    spread(model.decoder.head_half, lambda: model(image), 4, 1)
    return Authors(model, ("depth",), prepare, enlarge("bilinear", align_corners=True))
