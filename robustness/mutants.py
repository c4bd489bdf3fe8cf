"""Files and values that nobody meant to write, made of good ones, the same for the same number."""

import json
import random
import struct
import zlib
from typing import Any

_OF_IMAGES = (b"\xff" * 64, b"\xff\xd9", b"\xff\xc0\0\x11\x08\xff\xff\xff\xff")
_OF_BOXES = (b"IEND", b"eXIf", b"\x7f\xff\xff\xff", b"ispe", b"iloc", b"\x1aE\xdf\xa3\xff")
_OF_TEXTS = (b"1e999", b"-nan", b"\xed\xa0\x80", b"\\ud800", b"[" * 3000, b'{"a":' * 3000)
_OF_PATHS = (b"9" * 5000, b"../../x", b"\x1b[2J")
_OF_EXIF = (b"Exif\0\0II*\0\x08\0\0\0",)
TOKENS = (b"\0", *_OF_IMAGES, *_OF_EXIF, *_OF_BOXES, *_OF_TEXTS, *_OF_PATHS)
"""What formats of images, videos and texts give a meaning to."""

_WHOLE = (0, -1, 1, 2**31, 2**63, 2**64, 10**30)
_REAL = (0.0, -0.0, 1e-320, 1e308, float("inf"), float("nan"))
_TEXTS = ("", "\0", "\ud800", "../../x", "a" * 3000, "\x1b[2J", "9" * 5000)
VALUES: tuple[Any, ...] = (None, True, *_WHOLE, *_REAL, *_TEXTS, [], [[]], {}, {"": None})
"""What a field may hold that nobody expects there."""

_INTEGERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_PNG = b"\x89PNG\r\n\x1a\n"


def mutant(seeds: list[bytes], key: str) -> bytes:
    """A file that differs from one of the seeds in a few places.

    Args:
        seeds: good files.
        key: the same key gives the same bytes.
    """
    chance = random.Random(key)  # noqa: S311 - not a secret
    seed = chance.choice(seeds)
    changed = _structured(seed, chance) if chance.random() < 0.6 else None
    data = bytearray(seed if changed is None else changed)
    if changed is None or chance.random() < 0.1:
        for _ in range(chance.choice((1, 1, 2, 3, 8))):
            _change(data, seeds, chance)
    if data.startswith(_PNG) and chance.random() < 0.7:
        return _with_checksums(bytes(data))
    return bytes(data)


def changed_value(value: Any, chance: random.Random) -> Any:
    """A copy of nested lists and dictionaries with something in it exchanged."""
    if isinstance(value, dict) and value and chance.random() < 0.85:
        name = chance.choice(list(value))
        match chance.randrange(12):
            case 0:
                return {key: item for key, item in value.items() if key != name}
            case 1:
                return value | {chance.choice(("", "x" * 3000, "\ud800", "\x1b", "a")): 1}
        return value | {name: changed_value(value[name], chance)}
    if isinstance(value, (list, tuple)) and value and chance.random() < 0.7:
        at = chance.randrange(len(value))
        items = list(value)
        items[at : at + chance.randrange(2)] = [changed_value(items[at], chance)]
        return type(value)(items)
    if isinstance(value, (int, float)) and chance.random() < 0.3:
        return value * chance.choice((-1, 0, 10, 1e6, 1e300, 0.5))
    return chance.choice(VALUES)


def _structured(seed: bytes, chance: random.Random) -> bytes | None:
    """JSON, or lines of JSON, with a value exchanged; None of other files."""
    lines = seed.splitlines()
    try:
        if seed[:1] != b"{":
            return None
        if len(lines) > 1 and lines[0].endswith(b"}"):
            at = chance.randrange(len(lines))
            lines[at] = json.dumps(changed_value(json.loads(lines[at]), chance)).encode()
            return b"\n".join(lines) + b"\n"
        return json.dumps(changed_value(json.loads(seed), chance)).encode()
    except ValueError:
        return None


def _change(  # noqa: C901 - one case a way to change
    data: bytearray, seeds: list[bytes], chance: random.Random
) -> None:
    at = chance.randrange(len(data) + 1) if chance.random() < 0.6 else chance.randrange(65)
    at = min(at, len(data))
    span = chance.choice((1, 2, 4, 8, 64, 1000))
    match chance.randrange(9):
        case 0 | 1:
            if at < len(data):
                data[at] ^= 1 << chance.randrange(8)
        case 2:
            form = chance.choice(("B", "<H", ">H", "<I", ">I", "<Q", ">Q"))
            most = (1 << 8 * struct.calcsize(form)) - 1
            number = struct.pack(form, chance.choice(_INTEGERS) & most)
            data[at : at + len(number)] = number
        case 3:
            del data[at : at + span]
        case 4:
            data[at:at] = data[at : at + span]
        case 5:
            data[at:at] = chance.choice(TOKENS)
        case 6:
            data[at : at + span] = chance.randbytes(min(span, len(data) - at))
        case 7:
            other = chance.choice(seeds)
            start = chance.randrange(len(other) + 1)
            data[at : at + span] = other[start : start + span]
        case 8:
            if chance.random() < 0.5:
                del data[at:]
            else:
                data[at:at] = bytes([chance.randrange(256)]) * chance.choice((10, 1000, 100_000))


def _with_checksums(png: bytes) -> bytes:
    """A PNG whose checksums are right, so that what is wrong in its chunks is looked at."""
    data, at = bytearray(png), len(_PNG)
    while at + 12 <= len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")
        if end + 4 > len(data):
            break
        data[end : end + 4] = struct.pack(">I", zlib.crc32(data[at + 4 : end]))
        at = end + 4
    return bytes(data)
