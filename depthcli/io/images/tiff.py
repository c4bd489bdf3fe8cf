"""TIFF files (TIFF 6.0, and BigTIFF): the first image's size and layout; the count of others."""

import struct
from collections.abc import Mapping
from contextlib import suppress

from depthcli.errors import InputError
from depthcli.io.images.exif import LAYOUTS, read_tags, tag_entries, unpack_at
from depthcli.io.images.opencv import Decoded, Header, decode_with_opencv
from depthcli.io.images.openimageio import decode_openimageio, needs_openimageio

_SUBFILE_TYPE, _REDUCED, _REDUCED_OR_MASK, _SUB_DIRECTORIES = 254, 0b1, 0b101, 330
_WIDTH, _HEIGHT, _BITS, _COMPRESSION = 256, 257, 258, 259
_PHOTOMETRIC, _SAMPLES, _PLANES, _EXTRA_SAMPLES, _FORMATS = 262, 277, 284, 338, 339
_TILE_WIDTH, _TILE_HEIGHT, _LEAST_TILE_BYTES = 322, 323, 1024
_TAGS = (
    *(_SUBFILE_TYPE, _SUB_DIRECTORIES, _WIDTH, _HEIGHT, _BITS, _COMPRESSION),
    *(_PHOTOMETRIC, _SAMPLES, _PLANES, _EXTRA_SAMPLES, _FORMATS, _TILE_WIDTH, _TILE_HEIGHT),
)
_ASSOCIATED, _UNASSOCIATED = 1, 2  # alpha: whether colours are multiplied by it
_EIGHT, _SIXTEEN, _MAX_CHANNELS = 8, 16, 4
# With any other, OpenCV returns a black image.
_COMPRESSIONS_OF_OPENCV = frozenset(
    {1, 2, 3, 4, 5, 6, 7, 8, 32773, 32946, 34676, 34677, 34887, 34925, 50000, 50001}
)
_UNCOMPRESSED = 1
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _PLANAR, _FLOAT = 0, 1, 2, 2, 3


def tiff_header(data: bytes) -> Header:
    """Size of the first image of a TIFF, the value of its white, and how many others there are."""
    tags = _first_directory(data)
    if tags.get(_SUBFILE_TYPE, 0) & _REDUCED and _SUB_DIRECTORIES in tags:
        told = "has a thumbnail as its first image, as camera raw files do"
        raise InputError(told, "convert it to JPEG, PNG or TIFF first")
    problem = _not_for_opencv(tags)
    if problem:
        needs_openimageio(problem)
    bits, count = tags.get(_BITS, 1), _image_count(data)
    return Header(
        tags[_WIDTH],
        tags[_HEIGHT],
        f"has {count} images; only the first is used" if count > 1 else None,
        # OpenCV shifts packed bits to the left.
        white=(1 << _SIXTEEN) - (1 << _SIXTEEN - bits) if _EIGHT < bits < _SIXTEEN else None,
        is_upright=True,
    )


def decode_tiff(data: bytes) -> Decoded:
    """Pixels of the first image, upright, because OpenCV's reader always turns it."""
    tags = _first_directory(data)
    if _not_for_opencv(tags):
        return decode_openimageio(data)
    has_alpha = tags.get(_EXTRA_SAMPLES) in (_ASSOCIATED, _UNASSOCIATED)
    found = decode_with_opencv(_with_colours_as_stored(data), has_alpha=has_alpha)
    return found._replace(exif=data)


def _first_directory(data: bytes) -> dict[int, int]:
    """The first value of each tag of the first image; of the bits, their maximum."""
    found = {tag: values for tag, values in read_tags(data, _TAGS) if values}
    return {tag: max(values) if tag == _BITS else values[0] for tag, values in found.items()}


def _not_for_opencv(tags: Mapping[int, int]) -> str | None:
    """Reason why OpenCV would decode wrong pixels without an error; None if it does not."""
    coding, channels = tags.get(_COMPRESSION, 1), tags.get(_SAMPLES, 1)
    if coding not in _COMPRESSIONS_OF_OPENCV:
        return f"has the TIFF compression {coding}"
    if channels > _MAX_CHANNELS:
        return f"has {channels} channels"
    if tags.get(_BITS, 1) <= _EIGHT:
        tile = tags.get(_TILE_WIDTH, 0) * tags.get(_TILE_HEIGHT, 0) * channels
        # OpenCV takes tifffile's and tiffcp's for damaged.
        is_small = 0 < tile < _LEAST_TILE_BYTES and coding == _UNCOMPRESSED
        return "has uncompressed tiles of less than a kilobyte" if is_small else None
    is_float = tags.get(_FORMATS, 1) == _FLOAT
    if is_float and tags[_BITS] == _SIXTEEN:
        return "has half-precision floats"
    if tags.get(_PLANES, 1) == _PLANAR and channels > 1:
        return "has a plane for each colour and more than 8 bits"
    photometric = tags.get(_PHOTOMETRIC, _RGB)
    if photometric == _WHITE_IS_ZERO:
        return "has 0 for white and more than 8 bits"
    is_for_gray = channels == 1 or (is_float and channels > 2)
    if photometric == _BLACK_IS_ZERO and not is_for_gray:
        return f"has gray in {channels} channels and more than 8 bits"
    return None


def _with_colours_as_stored(data: bytes) -> bytes:
    """The file with its alpha declared associated, so that no decoder multiplies by it."""
    with suppress(struct.error):
        for _, form, position in tag_entries(data, (_EXTRA_SAMPLES,), None):
            values = unpack_at(form, data, position)
            if _UNASSOCIATED in values:
                declared = (_ASSOCIATED if value == _UNASSOCIATED else value for value in values)
                tail = position + struct.calcsize(form)
                return data[:position] + struct.pack(form, *declared) + data[tail:]
    return data


def _image_count(data: bytes) -> int:
    """Directories in the file's chain, without reduced copies (thumbnails) and masks."""
    layout, seen, count = LAYOUTS[data[:4]], {0}, 0
    order, number = layout.order, layout.order + layout.number
    with suppress(struct.error):  # decoders, too, pass over what follows the first image
        (at,) = unpack_at(number, data, layout.start)
        while at not in seen:
            seen.add(at)
            kinds = dict(read_tags(data, (_SUBFILE_TYPE,), at)).get(_SUBFILE_TYPE) or (0,)
            count += not count or not kinds[0] & _REDUCED_OR_MASK
            (entries,) = unpack_at(order + layout.total, data, at)
            at += struct.calcsize(layout.total) + layout.entry * entries
            (at,) = unpack_at(number, data, at)
    return count
