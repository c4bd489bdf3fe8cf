"""Metadata and versions of an ONNX file, read from its bytes without a protobuf library.

An ONNX file is one protobuf message ``ModelProto``
(https://github.com/onnx/onnx/blob/main/onnx/onnx.proto). Its few top-level fields are enough to
find the embedded card and to detect a truncated file; tensors are skipped by their length.
"""

from collections.abc import Iterator
from mmap import mmap
from typing import NamedTuple, TypeAlias

from depthcli.errors import ModelError

_IR_VERSION, _GRAPH, _OPSETS, _METADATA = 1, 7, 8, 14
_OPSET_VERSION = 2
_ONNX_DOMAINS = {b"", b"ai.onnx"}
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_FIXED_SIZES = {_FIXED64: 8, _FIXED32: 4}
_MAX_VARINT_BITS = 64
_MAX_KEY_BITS = 32
_TENSOR = "tensor"
_EXTERNAL_DATA, _DATA_LOCATION = 13, 14  # of a tensor
_OTHER_KEYS = {b"offset", b"length", b"checksum"}  # of external data, beside its location
# Where tensors can be: message -> field -> message.
_SUBMESSAGES = {
    "model": {_GRAPH: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "graph": {1: "node", 5: _TENSOR, 15: "sparse"},
    "function": {7: "node", 11: "attribute"},
    "node": {5: "attribute"},
    "attribute": {5: _TENSOR, 6: "graph", 10: _TENSOR, 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: _TENSOR, 2: _TENSOR},
}


Content: TypeAlias = bytes | mmap


class OnnxFacts(NamedTuple):
    """Facts of an ONNX file beside its graph."""

    opset: int  #: version of the standard operators; 0 if it states none
    ir: int  #: version of the format; 0 if it states none
    metadata: dict[str, str]  #: texts by key
    #: names of the files with weights that are not inside; "" where no name is stated
    external: frozenset[str] = frozenset()


def read_facts(data: Content, where: str) -> OnnxFacts:
    """The facts of the bytes of a complete ONNX file; messages say ``where``."""
    try:
        return _facts(data)._replace(external=frozenset(_external_files(data)))
    except (IndexError, ValueError) as error:
        raise ModelError(
            f"{where} is damaged or not an ONNX file; download or export it again"
        ) from error


def _facts(data: Content) -> OnnxFacts:
    entries: dict[str, str] = {}
    has_graph, opset, ir = False, 0, 0
    for number, start, end in _message_fields(data, 0, len(data)):
        has_graph = has_graph or number == _GRAPH
        if number == _IR_VERSION:
            ir = _varint(data, start)[0]
        elif number in (_OPSETS, _METADATA):
            parts = {field: (a, b) for field, a, b in _message_fields(data, start, end)}
            first = data[slice(*parts.get(1, (0, 0)))]
            if number == _METADATA:
                entries[first.decode()] = data[slice(*parts.get(2, (0, 0)))].decode()
            elif first in _ONNX_DOMAINS and _OPSET_VERSION in parts:
                opset = _varint(data, parts[_OPSET_VERSION][0])[0]
    if not has_graph:
        raise ValueError
    return OnnxFacts(opset, ir, entries)


def _external_files(data: Content) -> Iterator[str]:
    """The file that each tensor anywhere in a model names for its values; "" for one unnamed."""
    messages = [("model", 0, len(data))]
    while messages:
        kind, at, stop = messages.pop()
        submessages = _SUBMESSAGES.get(kind, {})
        names, is_external = list[str](), False
        for number, start, end in _message_fields(data, at, stop):
            if number in submessages:
                messages.append((submessages[number], start, end))
            elif kind == _TENSOR and number == _EXTERNAL_DATA:
                entry = {field: data[a:b] for field, a, b in _message_fields(data, start, end)}
                names += [entry.get(2, b"").decode()] * (entry.get(1) not in _OTHER_KEYS)
            elif kind == _TENSOR and number == _DATA_LOCATION:
                is_external = bool(_varint(data, start)[0])
        yield from names or [""] * is_external


def _message_fields(data: Content, position: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Each field of a message as (number, start, end) of its payload."""
    while position < end:
        key, position = _varint(data, position)
        if key >> _MAX_KEY_BITS:  # libraries truncate it, and so read another field
            raise ValueError(key)
        number, wire = key >> 3, key & 7
        if wire == _BYTES:
            length, position = _varint(data, position)
        elif wire == _VARINT:
            length = _varint(data, position)[1] - position
        elif wire in _FIXED_SIZES:
            length = _FIXED_SIZES[wire]
        else:
            raise ValueError(wire)
        if number == 0 or position + length > end:
            raise ValueError(number)
        yield number, position, position + length
        position += length


def _varint(data: Content, position: int) -> tuple[int, int]:
    """The number at a position, and the position after it."""
    value = 0
    for shift in range(0, _MAX_VARINT_BITS, 7):
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:  # noqa: PLR2004 - the continuation bit
            return value, position
    raise ValueError(position)
