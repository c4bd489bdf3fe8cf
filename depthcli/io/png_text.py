"""Text chunks of PNG files (PNG specification, third edition, 11.3.3)."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_END = len(_SIGNATURE) + 25  # IHDR is 13 bytes in a chunk of 25 and always the first


def with_text(png: bytes, texts: Mapping[str, str]) -> bytes:
    """A PNG file with text added right after its header.

    Args:
        png: the file.
        texts: Latin-1 keywords of 1-79 characters; values may be any text.
    """
    chunks = b"".join(_chunk(keyword, text) for keyword, text in texts.items())
    return png[:_HEADER_END] + chunks + png[_HEADER_END:]


def read_text(png: bytes) -> dict[str, str]:
    """The tEXt and uncompressed iTXt chunks of a PNG file; damaged ones are left out."""
    texts = {}
    at = len(_SIGNATURE)
    while at + 12 <= len(png):
        length, kind = struct.unpack_from(">I4s", png, at)
        body = png[at + 8 : at + 8 + length]
        keyword, _, rest = body.partition(b"\0")
        if kind == b"tEXt":
            texts[keyword.decode("latin-1")] = rest.decode("latin-1")
        elif kind == b"iTXt" and rest[:2] == b"\0\0":
            text = rest[2:].split(b"\0", 2)[-1]
            texts[keyword.decode("latin-1")] = text.decode("utf-8", "replace")
        at += 12 + length
    return texts


def _chunk(keyword: str, text: str) -> bytes:
    name = keyword.encode("latin-1")
    try:
        kind, body = b"tEXt", name + b"\0" + text.encode("latin-1")
    except UnicodeEncodeError:
        kind, body = b"iTXt", name + b"\0\0\0\0\0" + text.encode()
    crc = zlib.crc32(kind + body)
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", crc)
