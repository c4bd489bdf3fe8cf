"""What the numbers of a depth video mean."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from depthcli.io.video.depth import DepthVideo
from depthcli.io.video.rates import rate_text

if TYPE_CHECKING:
    from pathlib import Path


def video_facts(path: Path, scale: float | None) -> dict[str, object]:
    """Size, rate, length, range and labels of a depth video; all of it is read.

    Args:
        path: the file.
        scale: steps a metre; None for what the file states.

    Raises:
        InputError: it cannot be read, or is no depth video.
    """
    video = DepthVideo(path, scale=scale)
    frames = valid = width = height = 0
    low: float | None = None
    high: float | None = None
    for depth in video:
        known = depth.values[np.isfinite(depth.values)]
        frames, valid = frames + 1, valid + known.size
        height, width = depth.values.shape
        if known.size:
            least, largest = float(known.min()), float(known.max())
            low = least if low is None else min(low, least)
            high = largest if high is None else max(high, largest)
    return {
        "file": str(path),
        "kind": video.kind.value,
        "unit": None if video.scale is None else "m",
        "width": width,
        "height": height,
        "frames": frames,
        "fps": None if video.rate is None else rate_text(video.rate),
        "valid": valid,
        "min": low,
        "max": high,
        "metadata": video.labels,
    }
