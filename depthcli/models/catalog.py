"""Finding, reading and checking a model before it is run.

An ONNX file is one protobuf message ``ModelProto``
(https://github.com/onnx/onnx/blob/main/onnx/onnx.proto). Its few top-level fields are enough to
find the embedded card and to detect a truncated file; tensors are skipped by their length.
"""

import hashlib
import json
import os
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from depthcli.core import options, validation
from depthcli.errors import ModelError, UsageError, os_errors_as
from depthcli.io.storage import paths
from depthcli.models.card import METADATA_KEY, DataFile, ModelCard

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
    external: frozenset[str]


def onnx_facts(path: Path, data: bytes | None = None) -> OnnxFacts:
    """The facts of a complete ONNX file whose weights are all inside, from disk or its content."""
    try:
        if data is not None:
            return _facts(data)
        with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as mapped:
            return _facts(mapped)
    except (IndexError, ValueError) as error:  # an empty file cannot be mapped
        problem = f"{path} is damaged or not an ONNX file; download or export it again"
        raise ModelError(problem) from error


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
    return OnnxFacts(opset, ir, entries, frozenset(_external_files(data)))


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


FOLDER = Path(__file__).parent / "cards"
NO_FILE_YET = {"opset": 1, "ir": 1}


def ready_names() -> tuple[str, ...]:
    """Names of the ready cards, in alphabetic order."""
    return tuple(path.stem for path in sorted(FOLDER.glob("*.json")))


def ready_fields(name: str) -> dict[str, Any]:
    """A ready card's JSON object, without the fields that depend on the file."""
    if name not in ready_names():
        raise UsageError(
            f"no ready card named {name!r}; see 'depthcli models cards', or give a .json file"
        )
    fields: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text("utf-8"))
    return fields


def ready_card(name: str) -> ModelCard:
    """A ready card, with placeholders for opset and IR version."""
    fields = ready_fields(name) | {"onnx": NO_FILE_YET}
    return ModelCard.from_json(json.dumps(fields), where=f"card {name}")


def how_to_write(path: Path) -> str:
    """Advice on a card for an ONNX file of one's own."""
    return f"write one: depthcli models new-card {shlex.quote(str(path))}"


def how_to_add(card: ModelCard, name: str) -> str:
    """Advice on adding the weights of a card, which has this name or is this file."""
    weights = card.weights
    if weights is None:
        return f"download its weights, and run: depthcli models add FILE {{card}} {name}"
    if weights.url is not None:
        return f"download its weights ({weights.url}) with: depthcli models add {name}"
    return (
        f"get its weights from {weights.page} and export them ('depthcli models cards {name}'), "
        f"then run: depthcli models add FILE {{card}} {name}"
    )


DEFAULT_MODEL = "default"
KNOWN_DEPTH_MODEL = "prompted"
"""The model that makes depth of known depth, where no model is named."""
MODELS_VARIABLE = "DEPTHCLI_MODELS"
CARD_NAME = "card.json"
CARD_SUFFIX = ".card.json"
_ONNX_SUFFIX = ".onnx"
_CHECKPOINTS = (".ckpt", ".pt", ".pth")


class ModelLocation(NamedTuple):
    """The files of a model, which have not been read yet."""

    path: Path  #: the file that messages name: the card's, else the ONNX file
    onnx: Path | None  #: the ONNX file; None where only its card names it
    card: Path | None  #: the card's file; None if the card is inside the ONNX file


def roots() -> tuple[Path, ...]:
    """Folders of models: the environment variable's, the user's, the bundled, a checkout's."""
    package = Path(__file__).resolve().parents[1]
    stated = filter(None, os.environ.get(MODELS_VARIABLE, "").split(os.pathsep))
    folders = [*map(Path, stated), paths.user_folder("data") / "models", package / "_bundled"]
    if (package.parent / "pyproject.toml").is_file():
        folders.append(package.parent / "models")
    return tuple(folders)


def user_root() -> Path:
    """The folder for installed models: the first of the environment variable, else the user's."""
    return roots()[0]


def list_locations() -> Iterator[tuple[str, ModelLocation]]:
    """The models of the catalog, sorted by name; the first folder that has a name counts."""
    locations: dict[str, ModelLocation] = {}
    for root in roots():
        children = sorted(root.iterdir()) if root.is_dir() else []
        for child in children:
            location = None if child.name.startswith(".") else location_at(child)
            if location:
                locations.setdefault(child.name.removesuffix(_ONNX_SUFFIX), location)
    yield from sorted(locations.items())


def location_at(path: Path) -> ModelLocation | None:
    """Files of the model at a path, a folder with a card or an ONNX file; None if there is none.

    A ``card.json`` beside an ONNX file is its card if it names the file.
    """
    if (card := path / CARD_NAME).is_file():
        return ModelLocation(card, onnx=None, card=card)
    if path.suffix == _ONNX_SUFFIX and path.is_file():
        beside = path.with_name(path.stem + CARD_SUFFIX)
        if beside.is_file():
            return ModelLocation(beside, onnx=path, card=beside)
        shared = path.with_name(CARD_NAME)
        if shared.is_file() and files_of_card(shared)[:1] == [path.name]:
            return ModelLocation(shared, onnx=path, card=shared)
        return ModelLocation(path, onnx=path, card=None)
    return None


MAX_BYTES = 2**31 - 1  # a protobuf message cannot be larger
_MAX_CARD_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class Model:
    """A model that was read and checked."""

    path: Path  #: its ONNX file
    card: ModelCard  #: describes its input and output
    sha256: str  #: checksum of the file, 64 hex digits
    size_bytes: int  #: size of the file
    #: content of a remote file; None for a local one, of which onnxruntime keeps a copy anyway
    data: bytes | None = field(default=None, repr=False)


def find_model(name_or_path: str | os.PathLike[str] | None = None) -> Model:
    """Find, read and check a model: the default one, or one of a name or a path.

    A path is that of a folder with a ``card.json``, or of an ``.onnx`` file with its card inside or
    beside it, where a ``card.json`` has to name the file.
    """
    name = os.fspath(DEFAULT_MODEL if name_or_path is None else name_or_path)
    separators = {os.sep, os.altsep or os.sep}
    is_path = name in {".", ".."} or name.endswith(_ONNX_SUFFIX) or bool(separators & {*name})
    folders = () if is_path else roots()
    candidates = [root / file for root in folders for file in (name, name + _ONNX_SUFFIX)]
    # The name may be too long, or its host not be reached.
    with os_errors_as(ModelError, f"no model at {options.short_repr(paths.safe_name(name))}"):
        location = next(filter(None, map(location_at, [*candidates, paths.path_of(name)])), None)
    if location:
        return read_model(location)
    if is_path:
        problem = f"no model at {paths.safe_name(name)!r}"
        raise ModelError(f"{problem}; give an .onnx file or a folder with {CARD_NAME}")
    advice = "see 'depthcli models list', or give a path"
    if name in ready_names():
        advice = f"it is a ready card; {how_to_add(ready_card(name), name)}"
    elif name.endswith(_CHECKPOINTS):
        advice = "'depthcli export-onnx' makes an ONNX file of a checkpoint of 'depthcli train'"
    raise ModelError(f"no model named {name!r}", advice)


def read_model(location: ModelLocation) -> Model:
    """Read and check a model."""
    beside, path = location.card, location.onnx
    card = ModelCard.from_json(read_limited(beside), where=str(beside)) if beside else None
    if path is None:
        if card is None or card.file is None:
            raise ModelError(
                f"{location.path}: file is missing; name the model's ONNX file in the card"
            )
        path = location.path.with_name(card.file)
    data = read_limited(path, MAX_BYTES) if isinstance(path, paths.RemotePath) else None
    size, sha256 = (len(data), hashlib.sha256(data).hexdigest()) if data else checksum(path)
    if card:
        check_file(card, path, size, sha256)
        for file in card.data:
            check_file(file, path.with_name(file.file), *checksum(path.with_name(file.file)))
    if card is None or card.sha256 is None:  # else it is the file that its card was made for
        facts = onnx_facts(path, data)
        if not facts.external <= {file.file for file in (card.data if card else ())}:
            raise ModelError(
                f"{path} keeps weights in a second file, which no checksum covers; 'depthcli models"
                " add' completes its card, or save both as one, with onnx.save(onnx.load('IN.onnx')"
                ", 'OUT.onnx') in Python"
            )
    if card is None:
        embedded = facts.metadata.get(METADATA_KEY)
        if embedded is None:
            raise ModelError(
                f"{path} has no card{unused_card(path)}; put {path.stem}{CARD_SUFFIX} beside it "
                f"('depthcli models cards' has ready ones), or {how_to_write(path)}"
            )
        card = ModelCard.from_json(embedded, where=f"card inside {path}")
    if card.onnx.opset is None:
        facts = onnx_facts(path, data)
        card = replace(card, onnx=replace(card.onnx, opset=facts.opset, ir=facts.ir))
    return Model(path, card, sha256, size, data)


def checksum(path: Path) -> tuple[int, str]:
    """Size and SHA-256 of a local model file, which may be larger than the memory."""
    with os_errors_as(ModelError, f"cannot read {path}"):
        size = paths.regular_size(path)
        with path.open("rb") as file:
            return size, hashlib.file_digest(file, "sha256").hexdigest()


def files_of_card(card: Path) -> list[str]:
    """Names of the files that a card states, first the ONNX file; none if it cannot be read."""
    try:
        fields = validation.validated(dict[str, Any], validation.parsed_json(read_limited(card)))
    except (ModelError, validation.FieldError):
        return []
    others = fields.get("data")
    entries = [fields, *(others if isinstance(others, list) else [])]
    files = (entry.get("file") for entry in entries if isinstance(entry, dict))
    return [file for file in files if isinstance(file, str)]


def unused_card(path: Path) -> str:
    """Why a ``card.json`` beside an ONNX file is not its card, for messages; empty without one."""
    card = path.with_name(CARD_NAME)
    if not card.is_file():
        return ""
    named = files_of_card(card)
    return f", and {card} " + (f"is that of {named[0]}" if named else "names no file")


def read_limited(path: Path, max_bytes: int = _MAX_CARD_BYTES) -> bytes:
    """Content of a local or remote file, by default of a card."""
    with os_errors_as(ModelError, f"cannot read {path}"):
        return paths.read_regular(path, max_bytes)


def check_file(card: ModelCard | DataFile, path: Path, size: int, sha256: str) -> None:
    """Compare a file's size in bytes and SHA-256 in hex with those in its card, if it has them."""
    again = "download or export the model again"
    if card.size_bytes is not None and card.size_bytes != size:
        raise ModelError(f"{path} has {size} bytes, its card says {card.size_bytes}; {again}")
    if card.sha256 is not None and card.sha256 != sha256:
        raise ModelError(f"{path} has another checksum than its card says; {again}")
