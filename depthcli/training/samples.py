"""Sample images of a training run: input, output and ground truth in three columns."""

from pathlib import Path

import cv2
import numpy as np
from lightning_fabric import Fabric
from torch import nn

from depthcli.core.types import DepthMap
from depthcli.io.formats.preview import PreviewWriter, percentiles
from depthcli.io.storage.atomic import atomic_path
from depthcli.training.validation import Validation

_ROWS = 6


def write_samples(
    folder: Path, epoch: int, validation: Validation, generator: nn.Module, fabric: Fabric
) -> None:
    """Write ``samples/epoch-NNNN.jpg`` for up to 6 held-out pairs, in the truth's colours."""
    rows = np.linspace(0, len(validation) - 1, min(_ROWS, len(validation))).astype(int).tolist()
    gray = ((validation.inputs(rows).numpy()[:, 0] + 1) * 127.5).astype(np.uint8)
    raw = validation.raw(generator, rows, fabric.device).numpy()[:, 0]
    codec = validation.config.output.codec
    lines = []
    for i, row in enumerate(rows):
        size = (gray.shape[2], gray.shape[1])
        depth_m = validation.store.depth_m[row, 0].float().numpy()
        truth_m = np.array(cv2.resize(depth_m, size), np.float32)
        output_m = np.array(cv2.resize(codec.decode(raw[i]), size), np.float32)
        if validation.store.valid_mask is not None:
            valid_mask = validation.store.valid_mask[row, 0].numpy().astype(np.uint8)
            truth_m[cv2.resize(valid_mask, size) == 0] = np.nan
        output, truth = DepthMap(output_m), DepthMap(truth_m)
        shown = [PreviewWriter().render(one, spread=percentiles(truth)) for one in (output, truth)]
        lines.append(np.hstack([cv2.cvtColor(gray[i], cv2.COLOR_GRAY2RGB), *shown]))
    encoded = cv2.imencode(".jpg", np.vstack(lines)[..., ::-1])[1]
    with atomic_path(sample_path(folder, epoch)) as temporary:
        temporary.write_bytes(encoded.tobytes())


def sample_path(folder: Path, epoch: int) -> Path:
    """The file with the sample images of an epoch."""
    return folder / "samples" / f"epoch-{epoch:04d}.jpg"
