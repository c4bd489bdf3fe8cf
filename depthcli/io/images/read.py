"""Reading an image from a file or from bytes to an upright frame."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.core.imageops import transfer_warning
from depthcli.core.options import EXPOSURE, MAX_PIXELS, ReadOptions
from depthcli.core.types import Frame
from depthcli.errors import InputError, UsageError
from depthcli.io.images.decode import CheckedImage, check, read_bytes
from depthcli.io.images.exif import parse_exif
from depthcli.io.images.headers import Decoded
from depthcli.io.images.pixels import as_frame_dtype, check_white_level, full_range, upright
from depthcli.io.listing.own_outputs import EXR_MAGIC, is_own_exr
from depthcli.io.storage.paths import RemotePath, path_of


def read_image(
    path: str | Path | None,
    data: bytes | None = None,
    *,
    max_pixels: int = MAX_PIXELS,
    name: str = "standard input",
    white_level: int | None = None,
    exposure: float = 0.0,
    layer: str | None = None,
) -> Frame:
    """Decode an image at its own bit depth and undo its EXIF rotation.

    Alpha is dropped; gray stays gray. Linear light of an EXR is encoded by the sRGB curve, and its
    overscan is included (see ``Frame.windows``). In another float image not-a-number and infinite
    pixels become 0 and the rest is clipped to [0, 1].

    Args:
        path: the file; with ``data``, only its name.
        data: the file's content, if it was read already (from standard input, for instance).
        max_pixels: images that claim more are refused before they are decoded.
        name: what messages call data without a path.
        white_level: value of white in a 16-bit image, such as 4095 for data of 12 bits; it is
            scaled so that this is 65535. None for 65535, or what an AVIF, HEIC or Netpbm states.
        exposure: stops by which linear light of an EXR is brightened before it is clipped to white.
        layer: of an EXR, that is its image, such as ``beauty``; None for that without a name,
            else the likeliest by its name.

    Returns:
        Gray (H, W) or RGB (H, W, 3); uint8, uint16 or float32.

    Raises:
        InputError: missing, empty, truncated, damaged, not an image, too large, float with
            another range than [0, 1], or an EXR that depthcli wrote or without this layer.
        OutputError: there is no room for the temporary copy that the data of an EXR needs.
        UsageError: the white level is not a whole number from 1 to 65535, or the exposure is not
            from -20 to 20.
    """
    check_white_level(white_level)
    if not EXPOSURE.holds(exposure):
        raise UsageError(f"an exposure of {exposure!r} is not {EXPOSURE.what}")
    path = None if path is None else path_of(path)
    name = name if path is None else str(path)
    file = path if data is None else None
    if data is None:
        if path is None:
            raise InputError("neither a file nor data was given")
        data = read_bytes(path)
    if data.startswith(EXR_MAGIC):
        options = ReadOptions(exposure=exposure, layer=layer)
        return replace(_exr_picture(file, data, name, max_pixels, options), path=path)
    image = check(data, name, max_pixels)
    decoded = image.decode()
    exif, header = parse_exif(decoded.exif), image.header
    orientation = header.orientation or exif.orientation
    pixels, warnings = _frame_pixels(decoded, image, white_level, exposure)
    if not header.is_upright:
        pixels = upright(pixels, orientation)
    return Frame(
        np.ascontiguousarray(pixels),
        path,
        orientation=orientation,
        focal_35mm=exif.focal_35mm,
        warnings=tuple(filter(None, (header.warning, *warnings))),
    )


def _frame_pixels(
    decoded: Decoded, image: CheckedImage, white_level: int | None, exposure: float
) -> tuple[npt.NDArray[Any], tuple[str | None, ...]]:
    """Pixels of a frame, not turned yet, and warnings about them."""
    header, pixels = image.header, decoded.pixels
    if decoded.is_linear:
        from depthcli.io.exr.image import clip_warning, encode  # noqa: PLC0415 - rare

        light = pixels.reshape(*pixels.shape[:2], -1)
        above = encode(light, exposure)
        return light.reshape(pixels.shape), (clip_warning(above / light[..., 0].size),)
    pixels, warnings = full_range(pixels, header.white, white_level)
    hdr = transfer_warning(header.transfer, "picture", "sRGB")
    return as_frame_dtype(pixels, image.name), (*warnings, hdr)


def _exr_picture(
    file: Path | None,
    data: bytes,
    name: str,
    max_pixels: int,
    options: ReadOptions,
) -> Frame:
    """The image in an EXR; of its data if there is no file, or none on this machine."""
    # Other images need not wait for it.
    from depthcli.io.exr.image import read_exr_data, read_exr_image  # noqa: PLC0415

    if is_own_exr(data):
        raise InputError(
            f"{name} was written by depthcli; name a picture, or use 'depthcli convert' for depth "
            "files"
        )
    if file is None or isinstance(file, RemotePath):
        return read_exr_data(data, name, max_pixels, options)
    return read_exr_image(file, max_pixels=max_pixels, options=options)
