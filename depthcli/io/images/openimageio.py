"""Formats of film, print and the web that OpenImageIO reads, and rarer layouts of TIFF.

It is an extra; the only module that imports it.
"""

import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import numpy as np

from depthcli.core.options import INSTALL_FORMATS
from depthcli.core.types import AnyArray
from depthcli.errors import InputError, OutputError, os_errors_as
from depthcli.io.images.opencv import Decoded, Header
from depthcli.io.images.pixels import upright
from depthcli.io.media import is_installed
from depthcli.io.storage.atomic import NO_ROOM, temporary_folder

_FORMATS = {  # names of formats by the first bytes of their files
    b"SDPX": "DPX",
    b"XPDS": "DPX",
    b"\x80\x2a\x5f\xd7": "Cineon",
    b"\xd7\x5f\x2a\x80": "Cineon",
    b"#?RADIANCE": "Radiance HDR",
    b"#?RGBE": "Radiance HDR",
    b"8BPS": "a Photoshop document",
    b"\xff\x0a": "JPEG XL",
    b"\0\0\0\x0cJXL ": "JPEG XL",
    b"\0\0\0\x0cjP  ": "JPEG 2000",
    b"\xff\x4f\xff\x51": "JPEG 2000",
}
_TGA_END = b"TRUEVISION-XFILE.\0"
# Without this: kinds of palette and of image, its place, size, bits a pixel, and attributes.
_TGA = re.compile(
    rb".[\0\1][\1-\3\x09-\x0b].{9}(?!\0\0)..(?!\0\0)..[\x08\x0f\x10\x18\x20][\0-\x3f]", re.DOTALL
)
_COMPRESS_AGAIN = "convert it, for example with 'tiffcp -c zip'"
_TYPES = ("uint8", "uint16")  # that pixels keep; others become float
_WHITE_IS_ZERO, _GRAY_ALPHA, _RGB = 0, 2, 3


def is_openimageio(data: bytes) -> bool:
    """Whether a file is of a format that only OpenImageIO reads."""
    return _format_of(data) is not None


def needs_openimageio(problem: str) -> None:
    """Check that OpenImageIO is there for a problem, the middle of a sentence."""
    if not is_installed("OpenImageIO"):
        raise InputError(f"{problem}, which needs OpenImageIO", INSTALL_FORMATS)


def openimageio_header(data: bytes) -> Header:
    """Size of an image."""
    needs_openimageio(f"is {_format_of(data)}")
    with _opened(data) as file:
        spec = file.spec()
        return Header(spec.width, spec.height, is_upright=True)


def decode_openimageio(data: bytes) -> Decoded:
    """Pixels of the first image, upright; white is the maximum of their type."""
    with _opened(data) as file:
        spec = file.spec()
        kind = str(spec.format) if str(spec.format) in _TYPES else "float"
        channels = _RGB if spec.nchannels >= _RGB else 1
        has_alpha = spec.alpha_channel == channels == spec.nchannels - 1
        count = channels + has_alpha
        pixels: AnyArray | None = file.read_image(0, 0, 0, count, kind)
        if pixels is None or file.has_error:
            raise _error(file.geterror())
        if spec.getattribute("tiff:PhotometricInterpretation") == _WHITE_IS_ZERO:
            pixels = (np.iinfo(pixels.dtype).max if kind in _TYPES else 1) - pixels
        space = str(spec.getattribute("oiio:ColorSpace"))
        aspect = spec.getattribute("PixelAspectRatio") if _format_of(data) == "DPX" else None
        pixels = upright(pixels, spec.getattribute("Orientation") or 1)
    return Decoded(
        np.ascontiguousarray(pixels[..., :_RGB] if channels == _RGB else pixels[..., 0]),
        alpha=pixels[..., channels] if has_alpha else None,
        is_linear=kind == "float" and space.startswith("lin"),
        pixel_aspect=aspect or 1.0,
    )


def _format_of(data: bytes) -> str | None:
    if data.endswith(_TGA_END) or _TGA.match(data):
        return "Targa"
    return next((name for start, name in _FORMATS.items() if data.startswith(start)), None)


@contextmanager
def _opened(data: bytes) -> Iterator[Any]:
    """The file, opened from a temporary copy, because OpenImageIO reads no memory from Python."""
    import OpenImageIO as oiio  # noqa: N813, PLC0415 - an extra, and slow to load

    with temporary_folder() as folder:
        path = folder / "image"
        with os_errors_as(OutputError, *NO_ROOM):
            path.write_bytes(data)
        options = oiio.ImageSpec()
        options["oiio:UnassociatedAlpha"] = 1  # colours as they are stored
        file = oiio.ImageInput.open(str(path), options)
        if file is None:
            raise _error(oiio.geterror())
        with closing(file):
            yield file


def _error(text: str) -> InputError:
    reason = " ".join(text.split()) or "it cannot be decoded"
    if re.search("not (configured|implemented)", reason):  # LERC, ZSTD and LZMA in its wheels
        return InputError(f"has a compression that is not supported ({reason})", _COMPRESS_AGAIN)
    return InputError(f"is damaged ({reason})", "copy it again")
