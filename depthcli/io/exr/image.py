"""Images in OpenEXR files, converted from linear light to sRGB."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from depthcli.core.imageops import PANORAMA, row_bands
from depthcli.core.options import AS_STATED, MAX_PIXELS, Projection, ReadOptions, check_pixel_count
from depthcli.core.types import Float32Array, Float64Array, Frame, Window, Windows
from depthcli.errors import InputError, Message

_LINEAR_UP_TO = 0.0031308
_REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # x, y of R, G, B and white
_SAME_PRIMARIES = 0.02  # those of Rec. 601 differ by 0.01, which changes no depth
_BRADFORD = np.array(  # from CIE XYZ to cone responses, in which one white is adapted to another
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
_MOST_GAIN = 100.0  # no matrix of real primaries has larger values
_NO_PRIMARIES = "the header's chromaticities are not valid primaries; those of Rec. 709 are assumed"
_MOST_LIGHT = 1e6
_MANY = 0.3  # share of clipped pixels from which abs_rel grows by .01


def encode(pixels: Float32Array, exposure: float = 0.0, matrix: Float32Array | None = None) -> int:
    """Encode linear light (H, W, C) as sRGB (IEC 61966-2-1), in place, clipped; NaN becomes 0.

    It is brightened by some stops, and its colours are converted to Rec. 709 by a (3, 3) matrix.
    Returns how many pixels are above 1, in the colour that has most of them.
    """
    height, width, colours = pixels.shape
    above = np.zeros(colours, np.int64)
    gain = np.float32(2**exposure)
    for rows in row_bands(width, height):  # of the whole, it takes several times its memory
        light = np.clip(np.nan_to_num(pixels[rows]), -_MOST_LIGHT, _MOST_LIGHT) * gain
        if matrix is not None:
            light = np.matmul(light, matrix.T, dtype=np.float32)
        above += np.count_nonzero(light > 1, axis=(0, 1))
        light = np.clip(light, 0, 1)
        curve = np.float32(1.055) * light ** np.float32(1 / 2.4) - np.float32(0.055)
        pixels[rows] = np.where(light <= _LINEAR_UP_TO, light * np.float32(12.92), curve)
    return int(above.max())


def clip_warning(share: float) -> str | None:
    """A warning about a large share of pixels above 1; None about few."""
    if share < _MANY:
        return None
    return Message(
        f"{share:.0%} of its pixels are above 1 and become white",
        "for better depth, give a lower exposure, such as {exposure} -1",
    )


def primaries_matrix(
    chromaticities: Sequence[float] | None,
) -> tuple[Float32Array | None, str | None]:
    """From colours of CIE x and y of red, green, blue and white to those of Rec. 709.

    White is adapted (Bradford). The matrix, (3, 3), is None if there is nothing to convert; the
    second is a warning if they are no primaries.
    """
    if chromaticities is None or np.allclose(chromaticities[:6], _REC_709[:6], 0, _SAME_PRIMARIES):
        return None, None
    matrix = np.full((3, 3), np.nan)
    with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
        to_xyz, white = _to_xyz(chromaticities)
        target_to_xyz, target_white = _to_xyz(_REC_709)
        adapted = np.diag(_BRADFORD @ target_white / (_BRADFORD @ white))
        adaptation = np.linalg.solve(_BRADFORD, adapted @ _BRADFORD)
        matrix = np.linalg.solve(target_to_xyz, adaptation @ to_xyz)
    if not np.abs(matrix).max() < _MOST_GAIN:  # nor if it is not a number
        return None, _NO_PRIMARIES
    return matrix.astype(np.float32), None


def _to_xyz(chromaticities: Sequence[float]) -> tuple[Float64Array, Float64Array]:
    """The matrix from linear RGB to CIE XYZ, and XYZ of white, whose Y is 1."""
    x, y = np.reshape(np.asarray(chromaticities, np.float64), (4, 2)).T
    corners = np.stack([x, y, 1 - x - y])
    white = corners[:, 3] / y[3]
    return corners[:, :3] * np.linalg.solve(corners[:, :3], white), white


def read_exr_image(
    source: Path | bytes,
    *,
    name: str | None = None,
    max_pixels: int = MAX_PIXELS,
    overscan: Window | None = None,
    options: ReadOptions = AS_STATED,
) -> Frame:
    """The colours of an EXR file or its content, encoded for display, and what its header states.

    They are linear light of Rec. 709 primaries in the sRGB curve, clipped, and mirrored outside the
    data window. ``overscan`` is the window to read, relative to the corner of the display window;
    None for the display window and all that the data window has around it.
    """
    from depthcli.io.exr import file as exr_file  # noqa: PLC0415 - OpenEXR is slow to load

    name = name or str(source)
    channels = exr_file.read_exr_channels(source, name=name, max_pixels=max_pixels)
    names, doubt = exr_file.colour_channels(name, list(channels), options.layer)
    part = channels[names[0]].part
    if part.is_cube:
        advice = "'exrenvmap -l' makes an equirectangular image of it"
        raise InputError(f"{name} is a cube map, which is not supported", advice)
    chroma = tuple(exr_file.layer_of(names[0]) + word for word in ("RY", "BY"))
    if is_luminance := len(names) == 1 and channels.keys() >= {*chroma}:
        names += chroma
    whole = part.display.union(part.data)
    if overscan is not None:
        whole = overscan.moved(part.display.left, part.display.top)
    check_pixel_count(name, whole.width, whole.height, max_pixels)
    windows = Windows(whole, part.data, part.display)
    pixels = np.empty((whole.height, whole.width, len(names)), np.float32)
    for i, colour in enumerate(names):
        pixels[..., i] = channels.pop(colour).over(whole)  # each is freed when it is copied
    if windows.valid.width * windows.valid.height and not np.isfinite(pixels).any():
        raise InputError(f"{name} has no finite pixel")
    matrix, problem = primaries_matrix(part.chromaticities) if len(names) > 1 else (None, None)
    if is_luminance:
        _to_rgb(pixels, _REC_709 if problem else part.chromaticities or _REC_709)
    above = encode(pixels, options.exposure, matrix)
    if not windows.valid.is_empty:
        _mirror_outside(pixels, windows)
    warnings = (
        doubt,
        clip_warning(above / max(1, windows.valid.width * windows.valid.height)),
        problem,
        PANORAMA if part.is_environment and options.projection is None else None,
    )
    return Frame(
        pixels if len(names) > 1 else pixels[..., 0],
        source if isinstance(source, Path) else None,
        rate=part.rate,
        warnings=tuple(filter(None, warnings)),
        pixel_aspect=part.pixel_aspect,
        windows=windows,
        projection=options.projection or Projection.PINHOLE,
        time_code=part.time_code,
        view=part.view,
    )


def _to_rgb(pixels: Float32Array, chromaticities: Sequence[float]) -> None:
    """Convert luminance and chroma (H, W, 3), which are Y, R/Y - 1 and B/Y - 1, to RGB, in place.

    Source: OpenEXR's ImfRgbaYca.h.
    """
    red, green, blue = _to_xyz(chromaticities)[0][1].astype(np.float32)
    light = pixels[..., 0].copy()
    pixels[..., 0] = (pixels[..., 1] + 1) * light
    pixels[..., 2] = (pixels[..., 2] + 1) * light
    pixels[..., 1] = (light - red * pixels[..., 0] - blue * pixels[..., 2]) / green


def _mirror_outside(pixels: Float32Array, windows: Windows) -> None:
    """Fill (H, W, C) outside the data window by mirroring what is in it, in place.

    A network takes black for a surface. On 45 photographs, of which
    2 % are missing at one side, black changes the depth of the rest by 2.1 % (mean), the nearest
    pixel by 1.4 %, this by 1.3 %; if 10 % are, by 4.6, 5.7 and 4.4 %; if half is, by 14, 18, 12 %.
    """
    rows, columns = windows.valid.within(windows.pixels)
    down, across = (
        np.pad(np.arange(at.start, at.stop), (at.start, size - at.stop), "symmetric")
        for at, size in zip((rows, columns), pixels.shape, strict=False)
    )
    outside = np.r_[: columns.start, columns.stop : len(across)]
    for row in range(rows.start, rows.stop):  # of all at once, it could copy most of the image
        pixels[row, outside] = pixels[row, across[outside]]
    for row in (*range(rows.start), *range(rows.stop, len(pixels))):
        pixels[row] = pixels[down[row]]
