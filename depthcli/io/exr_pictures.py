"""Pictures in OpenEXR files, converted from linear light to sRGB."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from depthcli.core.choices import MAX_PIXELS
from depthcli.core.picture_limit import PictureLimit
from depthcli.core.picture_options import NO_OPTIONS, PictureOptions
from depthcli.core.types import Frame
from depthcli.core.windows import Window, Windows
from depthcli.errors import InputError, OutputError
from depthcli.io.exr_light import clip_warning, encode, primaries_matrix
from depthcli.io.listing.folder import is_exr
from depthcli.io.storage.temporary_folder import temporary_folder


def read_exr_picture(
    path: Path,
    *,
    name: str | None = None,
    max_pixels: int | PictureLimit = MAX_PIXELS,
    overscan: Window | None = None,
    options: PictureOptions = NO_OPTIONS,
) -> Frame:
    """The colours of an EXR, encoded for display, and what its header states.

    Args:
        path: the file; its R, G and B, or its Y, or those of the layer that is its picture.
        name: what messages call it; None for its path.
        max_pixels: pictures with more are refused before they are decoded.
        overscan: the window to read, relative to the corner of the display window; None for the
            display window and all that the data window has around it.
        options: exposure and layer.

    Returns:
        (H, W, 3) RGB or (H, W) gray, float32 in [0, 1]: linear light of Rec. 709 primaries in the
        sRGB curve, clipped; 0 where there is no data.

    Raises:
        InputError: missing, damaged, without colours or the layer, or too large.
    """
    # OpenEXR is slow to load.
    from depthcli.io.depth.exr_channels import read_exr_channels  # noqa: PLC0415
    from depthcli.io.depth.exr_colours import colour_channels  # noqa: PLC0415

    name = name or str(path)
    limit = PictureLimit.of(max_pixels)
    channels = read_exr_channels(path, name=name, limit=limit)
    names, doubt = colour_channels(name, list(channels), options.layer)
    part = channels[names[0]].part
    whole = part.display.union(part.data)
    if overscan is not None:
        whole = overscan.moved(part.display.left, part.display.top)
    limit.check(name, whole.width, whole.height)
    windows = Windows(whole, part.data, part.display)
    pixels = np.empty((whole.height, whole.width, len(names)), np.float32)
    for i, colour in enumerate(names):
        pixels[..., i] = channels.pop(colour).over(whole)  # each is freed when it is copied
    if windows.valid.width * windows.valid.height and not np.isfinite(pixels).any():
        raise InputError(f"{name} has no finite pixel; write it again")
    matrix, problem = primaries_matrix(part.chromaticities) if len(names) > 1 else (None, None)
    above = encode(pixels, options.exposure, matrix)
    warnings = (
        doubt,
        clip_warning(above / max(1, windows.valid.width * windows.valid.height)),
        problem,
    )
    return Frame(
        pixels if len(names) > 1 else pixels[..., 0],
        path,
        rate=part.rate,
        warnings=tuple(filter(None, warnings)),
        pixel_aspect=part.pixel_aspect,
        windows=windows,
        time_code=part.time_code,
    )


def read_exr_data(
    data: bytes,
    name: str,
    max_pixels: int | PictureLimit = MAX_PIXELS,
    options: PictureOptions = NO_OPTIONS,
) -> Frame:
    """What :func:`read_exr_picture` returns, of the content of a file; without a path.

    ``name`` is what messages call it.

    Raises:
        InputError: damaged, without colours or the layer, or too large.
        OutputError: there is no room for a temporary copy, which OpenEXR needs.
    """
    with temporary_folder() as folder:
        copy = folder / "picture.exr"
        try:
            copy.write_bytes(data)
        except OSError as error:
            raise OutputError(
                f"cannot write a temporary file: {error.strerror}; set TMPDIR"
            ) from error
        frame = read_exr_picture(copy, name=name, max_pixels=max_pixels, options=options)
    return replace(frame, path=None)


def read_exr_rate(path: Path) -> Fraction | None:
    """Frames a second that an EXR's header states; None for other files, or if it does not."""
    if not is_exr(path.name):
        return None
    # OpenEXR is slow to load.
    from depthcli.io.depth.exr import read_exr_header  # noqa: PLC0415
    from depthcli.io.depth.exr_library import stated_rate  # noqa: PLC0415

    return stated_rate(read_exr_header(path))
