"""Sample pictures of a run."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from depthcli.training.samples import _coloured


@pytest.mark.parametrize("nearest_m", [0.1, 1.0])
def test_near_is_bright_and_beyond_the_range_is_its_end(nearest_m: float) -> None:
    depth_m = np.float32([[0.05, nearest_m, 0.7 * nearest_m, 2, 5, 10, 20]])
    seen_m = max(nearest_m, 0.3)
    shares = [
        min(max((1 / max(d, 0.3) - 0.1) / (1 / seen_m - 0.1), 0), 1) for d in depth_m[0].tolist()
    ]
    wanted = cv2.applyColorMap(np.uint8([[255 * s for s in shares]]), cv2.COLORMAP_INFERNO)
    np.testing.assert_allclose(_coloured(depth_m, nearest_m, 10.0), wanted, atol=3)
    flat = _coloured(np.full((1, 2), 3.0), 3.0, 3.0)
    np.testing.assert_array_equal(flat, cv2.applyColorMap(np.zeros((1, 2), np.uint8), 14))
