"""Picture formats that this build of OpenCV supports."""

import cv2
import numpy as np

PICTURE_SUFFIXES = (".jpg", ".png", ".tiff", ".webp", ".avif", ".bmp")
"""One suffix for each format that is read as a picture."""


def can_round_trip(suffix: str) -> bool:
    """Whether a picture can be encoded and decoded in a format; the suffix has its dot."""
    picture = np.full((16, 16, 3), 128, np.uint8)
    try:
        ok, data = cv2.imencode(suffix, picture)
        return bool(ok) and cv2.imdecode(data, cv2.IMREAD_UNCHANGED) is not None
    except cv2.error:
        return False
