"""Sample images of a training run: input, output and ground truth in three columns."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from lightning_fabric import Fabric
from torch import nn

from depthcli.io.storage.atomic import atomic_path
from depthcli.training.validation import Validation

_ROWS = 6
_NEAREST_M = 0.3


def write_samples(
    folder: Path, epoch: int, validation: Validation, generator: nn.Module, fabric: Fabric
) -> None:
    """Write ``samples/epoch-NNNN.jpg`` for up to 6 held-out pairs; near is bright."""
    rows = np.linspace(0, len(validation) - 1, min(_ROWS, len(validation))).astype(int).tolist()
    gray = ((validation.inputs(rows).numpy()[:, 0] + 1) * 127.5).astype(np.uint8)
    raw = validation.raw(generator, rows, fabric.device).numpy()[:, 0]
    codec = validation.config.output.codec
    lines = []
    for i, row in enumerate(rows):
        size = (gray.shape[2], gray.shape[1])
        truth_m = np.float32(cv2.resize(validation.store.depth_m[row, 0].float().numpy(), size))
        output_m = np.float32(cv2.resize(codec.decode(raw[i]), size))
        shown = [cv2.cvtColor(gray[i], cv2.COLOR_GRAY2BGR)]
        nearest_m, farthest_m = np.percentile(truth_m, (2, 98))
        shown += [_coloured(d, nearest_m, farthest_m) for d in (output_m, truth_m)]
        if validation.store.known is not None:
            known = validation.store.known[row, 0].numpy().astype(np.uint8)
            shown[-1][cv2.resize(known, size) == 0] = 0
        lines.append(np.hstack(shown))
    encoded = cv2.imencode(".jpg", np.vstack(lines))[1]
    with atomic_path(sample_path(folder, epoch)) as temporary:
        temporary.write_bytes(encoded.tobytes())


def sample_path(folder: Path, epoch: int) -> Path:
    """The file with the sample images of an epoch."""
    return folder / "samples" / f"epoch-{epoch:04d}.jpg"


def _coloured(depth_m: npt.ArrayLike, nearest_m: float, farthest_m: float) -> npt.NDArray[np.uint8]:
    inverse = 1 / np.maximum(np.asarray(depth_m), _NEAREST_M)
    low, high = 1 / max(farthest_m, _NEAREST_M), 1 / max(nearest_m, _NEAREST_M)
    share = np.clip((inverse - low) / max(high - low, 1e-6), 0, 1)
    shades = cv2.applyColorMap(np.asarray(share * 255, np.uint8), cv2.COLORMAP_INFERNO)
    return np.asarray(shades, np.uint8)
