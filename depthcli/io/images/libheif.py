"""Pictures in HEIF files, such as HEIC; the only module that imports pillow-heif."""

from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.core.imageops import transfer_warning
from depthcli.core.options import MAX_PIXELS
from depthcli.core.text import INSTALL_HEIF
from depthcli.core.types import Frame
from depthcli.errors import InputError
from depthcli.io.images.decode import check, scaled
from depthcli.io.images.exif import read_exif
from depthcli.io.images.native_log import decoder_messages

_EIGHT_BIT = 8
_RGB = (3, 4)  # channels, without and with alpha
_DAMAGE = (EOFError, LookupError, OSError, RuntimeError, SyntaxError, ValueError)
"""What pillow-heif raises about damaged files."""


def read_heif_picture(data: bytes, name: str, max_pixels: int = MAX_PIXELS) -> Frame:
    """The primary picture of a HEIF file, as its irot and imir turn it, whatever its EXIF states.

    Args:
        data: the whole file.
        name: what messages call it.
        max_pixels: pictures that claim more are refused before they are decoded.

    Returns:
        Gray (H, W) or RGB (H, W, 3), alpha dropped; uint8, or uint16 if it has more bits, scaled
        so that white is 65535. It has no path.

    Raises:
        InputError: truncated, damaged, too large, also for the memory, or pillow-heif is missing.
    """
    check(data, name, max_pixels)
    try:
        with decoder_messages():
            pixels, warnings = _decoded(data)
    except ImportError as error:
        raise InputError(f"{name} needs pillow-heif, which is broken; {INSTALL_HEIF}") from error
    except MemoryError as error:
        raise InputError(f"{name} does not fit into memory; make it smaller") from error
    except _DAMAGE as error:
        raise InputError(
            f"{name} is damaged, or of a variant that cannot be decoded; convert it to JPEG"
        ) from error
    exif = read_exif(data)
    return Frame(
        pixels, orientation=exif.orientation, focal_35mm=exif.focal_35mm, warnings=warnings
    )


def libheif_version() -> str:
    """The version of the decoder.

    Raises:
        ImportError: pillow-heif is missing or broken.
    """
    import pillow_heif  # noqa: PLC0415 - an extra

    return pillow_heif.libheif_version()


def _decoded(data: bytes) -> tuple[npt.NDArray[Any], tuple[str, ...]]:
    import pillow_heif  # noqa: PLC0415 - an extra

    options = {"convert_hdr_to_8bit": False, "hdr_to_16bit": False}
    file: Any = pillow_heif.open_heif(data, **options)  # the types of its facts are too wide
    picture = file[file.primary_index]
    channels, bits = len(picture.mode.partition(";")[0]), picture.info["bit_depth"]
    stored = np.asarray(picture)
    colours = stored.reshape(*stored.shape[:2], channels)
    pixels = np.array(colours[..., :3] if channels in _RGB else colours[..., 0], order="C")
    if bits != _EIGHT_BIT:
        pixels = scaled(pixels, (1 << bits) - 1)
    count = f"has {len(file)} pictures; only the primary one is used" if len(file) > 1 else None
    profile = picture.info.get("nclx_profile", {})
    transfer = transfer_warning(profile.get("transfer_characteristics", 0), "picture", "sRGB")
    return pixels, tuple(warning for warning in (count, transfer) if warning)
