"""AVIF and HEIF files (ISO/IEC 14496-12 and 23008-12): their boxes; those in HEVC decoded."""

import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from mmap import mmap
from typing import Any

import numpy as np

from depthcli.core.options import INSTALL_HEIF
from depthcli.core.types import AnyArray
from depthcli.errors import InputError
from depthcli.io.images.opencv import ANIMATED, Decoded, Header, decode_with_opencv
from depthcli.io.media import is_installed

_HEVC_BRANDS = frozenset((b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs"))
_AVIF_BRANDS = frozenset((b"avif", b"avis"))
_MAX_BRANDS_BYTES = 256
_ISPE = re.compile(rb"ispe")
_NCLX = re.compile(rb"colrnclx..(..)", re.DOTALL)
_CONFIGURATION = re.compile(rb"av1C\x81.(.)", re.DOTALL)
_HIGH, _TWELVE = 0x40, 0x20  # bits of a configuration: more than 8 bits, and then 12
_ROTATED = (1, 8, 3, 6)  # EXIF orientations that quarter turns counter-clockwise make upright
_MIRRORED = (2, 5, 4, 7)  # and those that mirroring left to right and then such turns do


def is_avif(data: bytes) -> bool:
    """Whether a file is HEIF coded in AV1."""
    return bool(_brands(data) & _AVIF_BRANDS)


def is_heif(data: bytes) -> bool:
    """Whether a file is HEIF coded in HEVC; AVIF, which has the same boxes, is not."""
    return bool(_brands(data) & _HEVC_BRANDS) and not is_avif(data)


def avif_header(data: bytes) -> Header:
    """Largest size of an AVIF's items, tiles and thumbnails among them, and what else is stated."""
    claims = data[: data.find(b"mdat")]
    starts = [match.end() + 4 for match in _ISPE.finditer(claims)]
    sizes = [struct.unpack_from(">II", claims, start) for start in starts]
    if not sizes:
        raise InputError("is truncated (its header is incomplete)", "copy it again")
    width, height = max(sizes, key=lambda size: size[0] * size[1])
    bits, colours = _CONFIGURATION.search(data), _NCLX.search(claims)
    flags = bits[1][0] if bits else 0
    return Header(
        width,
        height,
        ANIMATED if data[8:12] == b"avis" else None,
        white=None if not flags & _HIGH else 0xFFF if flags & _TWELVE else 0x3FF,
        orientation=property_orientation(data),
        transfer=int.from_bytes(colours[1], "big") if colours else 0,
    )


def property_orientation(data: bytes) -> int:
    """EXIF orientation that is the same as a file's irot and imir properties."""
    meta = find_box(data, b"meta")[4:]  # a version comes before its boxes
    properties = find_box(find_box(meta, b"iprp"), b"ipco")
    turn, axis = find_box(properties, b"irot")[:1], find_box(properties, b"imir")[:1]
    quarters = turn[0] & 3 if turn else 0
    if not axis:
        return _ROTATED[quarters]
    # Mirroring after a rotation is the opposite rotation after mirroring; top to bottom adds 180°.
    return _MIRRORED[-quarters % 4 if axis[0] & 1 else (2 - quarters) % 4]


def find_box(data: bytes, kind: bytes) -> bytes:
    """Content of the first box of a kind, as far as it is there; empty if there is none."""
    start, end = next(boxes(data, kind), (0, 0))
    return data[start:end]


def boxes(
    data: bytes | mmap, kind: bytes | None, start: int = 0, end: int | None = None, head: int = 8
) -> Iterator[tuple[int, int]]:
    """Where the content of each box of a kind, of all for None, begins and ends.

    The last one may end beyond the data; ``head`` is bytes of size and kind.
    """
    end = len(data) if end is None else end
    while start + head <= end:
        size, begin = int.from_bytes(data[start : start + 4]), start + head
        if size == 1:  # as of some cameras' pixels
            size, begin = int.from_bytes(data[start + 8 : start + 16]), start + 16
        stop = start + size if size else end
        if kind is None or data[start + 4 : start + 8] == kind:
            yield begin, stop
        if stop < begin:
            return
        start = stop


def _brands(data: bytes) -> set[bytes]:
    if data[4:8] != b"ftyp":
        return set()
    brands = find_box(data, b"ftyp")[:_MAX_BRANDS_BYTES]
    return {brands[at : at + 4] for at in range(0, len(brands), 4)}


_EIGHT_BIT = 8
_LIMITED = 1  # FFmpeg's number of the range of video
_RGB = (3, 4)  # channels, without and with alpha
_WITH_ALPHA = (2, 4)


def decode_avif(data: bytes) -> Decoded:
    """Pixels of an AVIF that codes no more of them than its boxes claim.

    libavif decodes whatever the AV1 sequence header states, up to 268 megapixels, and then scales.
    """
    import av  # noqa: PLC0415 - no other image needs FFmpeg

    header = avif_header(data)
    limit = {"max_pixels": str(header.width * header.height)}
    with suppress(av.FFmpegError), av.open(BytesIO(data), options=limit) as file:
        contexts = [stream.codec_context for stream in file.streams.video]
        if contexts and all(context.pix_fmt for context in contexts):  # none if it is larger
            is_limited = contexts[0].color_range == _LIMITED
            return decode_with_opencv(data, has_alpha=True)._replace(is_limited=is_limited)
    raise InputError("is damaged (its pixels are not those that it claims)", "copy it again")


def heif_header(data: bytes) -> Header:
    """Size of the primary image of a HEIF file, and what else it states."""
    start, end = next(boxes(data, b"mdat"), (0, 0))
    if not start < end <= len(data):  # libheif makes up tiles that are missing, without an error
        raise InputError("is truncated (its end is missing)", "copy it again")
    file = _opened(data)
    image = file[file.primary_index]
    (width, height), bits = image.size, image.info["bit_depth"]
    transfer = image.info.get("nclx_profile", {}).get("transfer_characteristics", 0)
    return Header(
        width,
        height,
        f"has {len(file)} images; only the primary one is used" if len(file) > 1 else None,
        orientation=property_orientation(data),
        is_upright=True,
        white=None if bits == _EIGHT_BIT else (1 << bits) - 1,
        transfer=transfer,
    )


def decode_heif(data: bytes) -> Decoded:
    """Pixels of the primary image, as its irot and imir turn it, whatever its EXIF states."""
    file = _opened(data)
    image = file[file.primary_index]
    channels = len(image.mode.partition(";")[0])
    colours = np.asarray(image)
    colours = colours.reshape(*colours.shape[:2], channels)
    pixels = np.array(colours[..., :3] if channels in _RGB else colours[..., 0], order="C")
    alpha = colours[..., -1] if channels in _WITH_ALPHA else None
    is_limited = image.info.get("nclx_profile", {}).get("full_range_flag") == 0
    return Decoded(pixels, image.info.get("exif") or b"", is_limited, alpha=alpha)


def depth_images(data: bytes) -> list[tuple[AnyArray, dict[str, Any]]]:
    """Depth images of the primary image, (H, W) upright, with what is stated of their numbers."""
    file = _opened(data)
    images = file[file.primary_index].info.get("depth_images", ())
    return [(np.asarray(image), image.info["metadata"]) for image in images]


def _opened(data: bytes) -> Any:  # noqa: ANN401 - the types of its facts are too wide
    if not is_installed("pillow_heif"):
        raise InputError("is HEIC, which needs pillow-heif", INSTALL_HEIF)
    import pillow_heif  # noqa: PLC0415 - an extra

    return pillow_heif.open_heif(data, convert_hdr_to_8bit=False, hdr_to_16bit=False)
