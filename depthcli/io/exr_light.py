"""Linear light of OpenEXR pictures: encoding it for display, and what that loses."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from depthcli.core.bands import row_bands

_LINEAR_UP_TO = 0.0031308
_REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06)
_SAME_PRIMARIES = 0.02  # those of Rec. 601 differ by 0.01, which changes no depth
_MANY = 0.3
"""Share of clipped pixels from which abs_rel grows by .01 (benchmarks/clipped_light.py)."""


def encode(linear: npt.NDArray[np.float32], encoded: npt.NDArray[np.float32]) -> int:
    """Write linear light, (H, W), into another array, encoded as sRGB (IEC 61966-2-1).

    It is clipped to [0, 1]; NaN becomes 0.

    Returns:
        How many pixels are above 1.
    """
    above = 0
    height, width = linear.shape
    for rows in row_bands(width, height):  # of the whole, it takes several times its memory
        encoded[rows] = _srgb(linear[rows])
        above += int(np.count_nonzero(linear[rows] > 1))
    return above


def _srgb(linear: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    light = np.clip(np.nan_to_num(linear), 0, 1)
    curve = np.float32(1.055) * light ** np.float32(1 / 2.4) - np.float32(0.055)
    shown: npt.NDArray[np.float32] = np.where(
        light <= _LINEAR_UP_TO, light * np.float32(12.92), curve
    )
    return shown


def clip_warning(share: float) -> str | None:
    """A warning about many pixels above 1; None about few.

    ``share`` is that of the pixels above 1 in the colour that has most of them.
    """
    if share < _MANY:
        return None
    return (
        f"{share:.0%} of its pixels are above 1 and become white; for better depth, lower its "
        "exposure first"
    )


def primaries_warning(primaries: Sequence[float] | None) -> str | None:
    """A warning about other primaries than those of Rec. 709; None if they are not stated.

    ``primaries`` are CIE x and y of red, green and blue.
    """
    pairs = zip(primaries or _REC_709, _REC_709, strict=True)
    if all(abs(stated - expected) <= _SAME_PRIMARIES for stated, expected in pairs):
        return None
    return (
        "its header states other primaries than those of Rec. 709, which its colours are taken "
        "for; convert it to linear Rec. 709 first"
    )
