"""Checking that onnxruntime and torch give the same outputs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from depthcli.errors import ParityError
from depthcli.inference.runtime import ort

TOLERANCE = 1e-3
FLOAT16_TOLERANCE = 2e-2
INT8_TOLERANCE = 2e-1


@dataclass(frozen=True, slots=True)
class Parity:
    """Differences between the runtimes, in units of the raw output (range about [-1, 1])."""

    max_abs: float  #: largest absolute difference over all cases
    mean_abs: float  #: mean absolute difference of the worst case
    cases: tuple[tuple[int, int, int], ...]  #: (batch, height, width) of each comparison
    tolerance: float  #: maximum difference allowed


def check_parity(
    network: nn.Module,
    model: bytes,
    cases: tuple[tuple[int, int, int], ...],
    tolerance: float = TOLERANCE,
    pictures: Sequence[npt.NDArray[np.float32]] = (),
) -> Parity:
    """Compare torch with onnxruntime on noise and on smooth pictures, or on given ones.

    Args:
        network: (B, 1, H, W) to raw (B, 1, h, w), in evaluation mode.
        model: the exported file.
        cases: (batch, height, width) of the inputs.
        tolerance: maximum difference allowed.
        pictures: (B, 1, H, W) inputs to use instead; int8 is accurate for real pictures only.

    Raises:
        ParityError: a difference is larger, or the model does not run at a size.
    """
    session = ort.InferenceSession(model, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    largest, worst_mean = 0.0, 0.0
    for case in cases:
        for batch in pictures or _inputs(*case):
            with torch.no_grad():
                wanted = network(torch.from_numpy(batch)).numpy()
            try:
                (found,) = session.run(None, {name: batch})
            except Exception as error:
                reason = str(error).strip().partition("\n")[0]
                raise ParityError(
                    f"the exported model does not run at batch, height, width {case}: {reason}; "
                    "nothing was written"
                ) from error
            if found.shape != wanted.shape:
                raise ParityError(f"at {case} torch gives {wanted.shape}, the model {found.shape}")
            difference = np.abs(found - wanted)
            # A NaN must not pass a comparison.
            largest = max(largest, float(np.nan_to_num(difference.max(), nan=np.inf)))
            worst_mean = max(worst_mean, float(difference.mean()))
    if largest > tolerance:
        raise ParityError(
            f"torch and onnxruntime differ by up to {largest:.2g}, more than {tolerance:g}; "
            "nothing was written"
        )
    return Parity(largest, worst_mean, cases, tolerance)


def _inputs(batch: int, height: int, width: int) -> tuple[npt.NDArray[np.float32], ...]:
    """Noise, a ramp with a step, and waves; each (batch, 1, height, width) in [-1, 1].

    No constant image: instance norm would amplify rounding errors, which differ between runtimes.
    """
    shape = (batch, 1, height, width)
    noise = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    ramp = np.broadcast_to(np.linspace(-1, 1, width, dtype=np.float32), shape).copy()
    ramp[..., height // 2 :, :] *= -1
    rows, columns = np.mgrid[0:height, 0:width]
    waves = np.sin(rows / 7) * np.cos(columns / 5)
    return noise, ramp, np.broadcast_to(waves.astype(np.float32), shape).copy()
