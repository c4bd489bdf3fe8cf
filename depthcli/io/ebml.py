"""Elements of Matroska files (RFC 8794, EBML): where they are, and what they hold."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import BinaryIO

_LONGEST_ID = 4
_LONGEST_SIZE = 8
_BYTE = 8


class Element(NamedTuple):
    """One element of a file.

    Attributes:
        id: with its length marker, as the specification prints it.
        start: offset of its content.
        size: bytes of content; None if the writer did not know.
        size_at: offset of the size field.
    """

    id: int
    start: int
    size: int | None
    size_at: int

    @property
    def end(self) -> int:
        """Offset behind it.

        Raises:
            ValueError: the size is unknown.
        """
        if self.size is None:
            msg = f"element {self.id:X} has no size"
            raise ValueError(msg)
        return self.start + self.size


def elements(file: BinaryIO, start: int, end: int) -> Iterator[Element]:
    """The elements that follow each other between two offsets.

    Args:
        file: open for reading; its position is moved.
        start: offset of the first.
        end: offset behind the last.

    Raises:
        ValueError: an element is cut off or has no size.
    """
    while start < end:
        element = element_at(file, start)
        yield element
        if element.end > end:
            msg = f"element {element.id:X} is cut off"
            raise ValueError(msg)
        start = element.end


def element_at(file: BinaryIO, offset: int) -> Element:
    """The element that begins at an offset.

    Raises:
        ValueError: there is none.
    """
    file.seek(offset)
    head = file.read(_LONGEST_ID + _LONGEST_SIZE)
    id_bytes = _length(head, 0)
    size_bytes = _length(head, id_bytes)
    start = id_bytes + size_bytes
    if id_bytes > _LONGEST_ID or start > len(head):
        msg = f"no element at {offset}"
        raise ValueError(msg)
    marked = int.from_bytes(head[id_bytes:start])
    size = marked & ~(1 << (7 * size_bytes))
    unknown = size == (1 << (7 * size_bytes)) - 1
    number = int.from_bytes(head[:id_bytes])
    return Element(number, offset + start, None if unknown else size, offset + id_bytes)


def content(file: BinaryIO, element: Element) -> bytes:
    """What an element holds."""
    file.seek(element.start)
    return file.read(element.end - element.start)


def packed(number: int, body: bytes) -> bytes:
    """An element as bytes, its size in eight of them."""
    head = number.to_bytes((number.bit_length() + _BYTE - 1) // _BYTE)
    return head + sized(len(body)) + body


def sized(size: int) -> bytes:
    """A size in eight bytes."""
    return ((1 << (7 * _LONGEST_SIZE)) | size).to_bytes(_LONGEST_SIZE)


def file_size(file: BinaryIO) -> int:
    """Bytes in a file."""
    return file.seek(0, os.SEEK_END)


def _length(head: bytes, at: int) -> int:
    """Bytes of the number that begins here: one more than its leading zeros."""
    first = head[at] if at < len(head) else 0
    return _BYTE - first.bit_length() + 1
