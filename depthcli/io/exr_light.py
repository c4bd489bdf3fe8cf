"""Linear light of OpenEXR pictures: encoding it for display, and what that loses."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from depthcli.core.bands import row_bands

_LINEAR_UP_TO = 0.0031308
_REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""CIE x and y of red, green, blue and white."""
_SAME_PRIMARIES = 0.02  # those of Rec. 601 differ by 0.01, which changes no depth
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
"""From CIE XYZ to cone responses, in which one white is adapted to another."""
_MOST_GAIN = 100.0
"""No matrix of real primaries has larger values."""
_NO_PRIMARIES = "the header's chromaticities are not valid primaries; those of Rec. 709 are assumed"
_MOST_LIGHT = 1e6
_MANY = 0.3
"""Share of clipped pixels from which abs_rel grows by .01 (benchmarks/clipped_light.py)."""


def encode(
    pixels: npt.NDArray[np.float32],
    exposure: float = 0.0,
    matrix: npt.NDArray[np.float32] | None = None,
) -> int:
    """Encode linear light as sRGB (IEC 61966-2-1), in place.

    It is clipped to [0, 1]; NaN becomes 0.

    Args:
        pixels: (H, W, C).
        exposure: stops by which it is brightened.
        matrix: (3, 3), from the colours of the pixels to those of Rec. 709; None for none.

    Returns:
        How many pixels are above 1, in the colour that has most of them.
    """
    height, width, colours = pixels.shape
    above = np.zeros(colours, np.int64)
    gain = np.float32(2**exposure)
    for rows in row_bands(width, height):  # of the whole, it takes several times its memory
        light = np.clip(np.nan_to_num(pixels[rows]), -_MOST_LIGHT, _MOST_LIGHT) * gain
        if matrix is not None:
            light = np.matmul(light, matrix.T, dtype=np.float32)
        above += np.count_nonzero(light > 1, axis=(0, 1))
        pixels[rows] = _srgb(light)
    return int(above.max())


def _srgb(linear: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    light = np.clip(linear, 0, 1)
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
        f"{share:.0%} of its pixels are above 1 and become white; for better depth, give a lower "
        "exposure (--exposure -1)"
    )


def primaries_matrix(
    chromaticities: Sequence[float] | None,
) -> tuple[npt.NDArray[np.float32] | None, str | None]:
    """From colours of stated primaries to those of Rec. 709, whose white is adapted (Bradford).

    Args:
        chromaticities: CIE x and y of red, green, blue and white; None for those of Rec. 709.

    Returns:
        (3, 3), or None if there is nothing to convert; and a warning if they are no primaries.
    """
    if chromaticities is None or np.allclose(chromaticities[:6], _REC_709[:6], 0, _SAME_PRIMARIES):
        return None, None
    try:
        to_xyz, white = _to_xyz(chromaticities)
        target_to_xyz, target_white = _to_xyz(_REC_709)
        adapted = np.diag(_BRADFORD @ target_white / (_BRADFORD @ white))
        adaptation = np.linalg.solve(_BRADFORD, adapted @ _BRADFORD)
        matrix = np.linalg.solve(target_to_xyz, adaptation @ to_xyz)
    except (np.linalg.LinAlgError, ValueError):
        return None, _NO_PRIMARIES
    if not np.abs(matrix).max() < _MOST_GAIN:  # nor if it is not a number
        return None, _NO_PRIMARIES
    return matrix.astype(np.float32), None


def _to_xyz(
    chromaticities: Sequence[float],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The matrix from linear RGB to CIE XYZ, and XYZ of white, whose Y is 1.

    Raises:
        LinAlgError, ValueError: there is none.
    """
    x, y = np.reshape(np.asarray(chromaticities, np.float64), (4, 2)).T
    if not y[3] > 0:
        msg = "white has no light"
        raise ValueError(msg)
    corners = np.stack([x, y, 1 - x - y])
    white = corners[:, 3] / y[3]
    return corners[:, :3] * np.linalg.solve(corners[:, :3], white), white
