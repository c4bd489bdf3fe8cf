"""HEIF files coded in HEVC, such as HEIC; the only module that imports pillow-heif."""

from typing import Any

import numpy as np

from depthcli.core.options import INSTALL_HEIF
from depthcli.errors import InputError
from depthcli.io.images.isobmff import is_cut_in_box, property_orientation
from depthcli.io.images.opencv import Decoded, Header
from depthcli.io.listing.folder import is_installed

_EIGHT_BIT = 8
_RGB = (3, 4)  # channels, without and with alpha
_DAMAGE = (EOFError, LookupError, OSError, RuntimeError, SyntaxError, ValueError)
"""What pillow-heif raises about damaged files."""


def heif_header(data: bytes) -> Header:
    """Size of the primary image of a HEIF file, and what else it states.

    Raises:
        InputError: truncated, damaged, or pillow-heif is missing.
    """
    if not is_installed("pillow_heif"):
        raise InputError("is HEIC, which needs pillow-heif", INSTALL_HEIF)
    if is_cut_in_box(data, b"mdat"):  # libheif makes up tiles that are missing, without an error
        raise InputError("is truncated (its end is missing)", "copy it again")
    file = _opened(data)
    image = file[file.primary_index]
    (width, height), bits = image.size, image.info["bit_depth"]
    transfer = image.info.get("nclx_profile", {}).get("transfer_characteristics", 0)
    return Header(
        width,
        height,
        f"has {len(file)} pictures; only the primary one is used" if len(file) > 1 else None,
        orientation=property_orientation(data),
        is_upright=True,
        white=None if bits == _EIGHT_BIT else (1 << bits) - 1,
        transfer=transfer,
    )


def decode_heif(data: bytes) -> Decoded:
    """Pixels of the primary image, as its irot and imir turn it, whatever its EXIF states.

    Raises:
        InputError: it is damaged.
    """
    file = _opened(data)
    image = file[file.primary_index]
    channels = len(image.mode.partition(";")[0])
    try:
        stored = np.asarray(image)
    except _DAMAGE as error:
        raise _damaged() from error
    colours = stored.reshape(*stored.shape[:2], channels)
    pixels = np.array(colours[..., :3] if channels in _RGB else colours[..., 0], order="C")
    return Decoded(pixels, image.info.get("exif") or b"")


def _opened(data: bytes) -> Any:  # noqa: ANN401 - the types of its facts are too wide
    try:
        import pillow_heif  # noqa: PLC0415 - an extra

        return pillow_heif.open_heif(data, convert_hdr_to_8bit=False, hdr_to_16bit=False)
    except ImportError as error:
        raise InputError("needs pillow-heif, which is broken", INSTALL_HEIF) from error
    except _DAMAGE as error:
        raise _damaged() from error


def _damaged() -> InputError:
    return InputError(
        "is damaged, or of a variant that cannot be decoded", "copy it again or convert it"
    )
