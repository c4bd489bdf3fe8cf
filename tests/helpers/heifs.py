"""HEIC files for tests, made with pillow-heif's own encoder."""

import io
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

pillow_heif = pytest.importorskip("pillow_heif", reason="HEIC needs pillow-heif")

_MODES = {1: "L", 3: "RGB", 4: "RGBA"}


def heic(*images: npt.NDArray[Any], **options: Any) -> bytes:
    """A HEIC of images (H, W) or (H, W, C), of 8 bits or, from uint16, of 10 or 12.

    Options are those of pillow-heif, such as ``exif`` and ``tile_size``.
    """
    container = pillow_heif.HeifFile()
    for image in images:
        height, width = image.shape[:2]
        mode = _MODES[image.shape[2] if image.ndim == 3 else 1]
        mode += ";16" if image.dtype == np.uint16 else ""
        container.add_frombytes(mode, (width, height), np.ascontiguousarray(image).tobytes())
    file = io.BytesIO()
    container.save(file, **{"quality": 90, "chroma": 444, **options})
    return file.getvalue()
