"""OpenEXR files: headers, channels with the windows that they are in, and writing them."""

import re
import sys
import threading
from collections.abc import Collection, Mapping, Sequence
from contextlib import redirect_stdout
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TextIO, TypeVar, cast

import numpy as np
import numpy.typing as npt
import OpenEXR

from depthcli.core.options import MAX_PIXELS, check_pixel_count, one_line
from depthcli.core.types import AnyArray, Float32Array, Window, over_window
from depthcli.errors import InputError, Message
from depthcli.io.storage.paths import RemotePath, read_bytes

OPENEXR_ERRORS = (RuntimeError, ValueError, TypeError, OSError, MemoryError, ArithmeticError)
_WINDOWS = ("dataWindow", "displayWindow")
_LOCK = threading.Lock()  # standard output is redirected meanwhile


class _OtherThreads:
    """Standard output, where results go, without what OpenEXR's bindings print in one thread."""

    def __init__(self, output: TextIO) -> None:
        self._output, self._thread = output, threading.get_ident()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever else a stream has
        return getattr(self._output, name)

    def write(self, text: str) -> int:
        """Pass on what other threads write."""
        return len(text) if threading.get_ident() == self._thread else self._output.write(text)


def _opened(source: Path | bytes) -> BinaryIO:
    """A file, or the content of one, for OpenEXR, which takes no names that are not UTF-8."""
    if isinstance(source, RemotePath):
        source = read_bytes(source)
    if isinstance(source, bytes):
        return BytesIO(source)
    read_bytes(source, first=1)  # errors of files are told apart here
    return source.open("rb")


def stated_rate(header: Mapping[str, Any]) -> Fraction | None:
    """Frames a second that a header states; None if it does not, or not above 0."""
    rate = header.get("framesPerSecond")
    return rate if isinstance(rate, Fraction) and rate > 0 else None


_FIELDS = (
    *("hours", "minutes", "seconds", "frame"),
    *("dropFrame", "colorFrame", "fieldPhase", "bgf0", "bgf1", "bgf2"),
)
_GROUPS, _GROUP_BITS = 8, 4


def stated_time_code(header: Mapping[str, Any]) -> tuple[int, ...] | None:
    """The numbers of the time code that a header states; None if there is no valid one."""
    time_code = header.get("timeCode")
    if not isinstance(time_code, OpenEXR.TimeCode):
        return None
    shifts = range(0, _GROUPS * _GROUP_BITS, _GROUP_BITS)
    groups = (time_code.userData >> shift & (1 << _GROUP_BITS) - 1 for shift in shifts)
    numbers = (*(int(getattr(time_code, field)) for field in _FIELDS), *groups)
    try:
        OpenEXR.TimeCode(*numbers)
    except OPENEXR_ERRORS:  # 45 hours, for instance
        return None
    return numbers


_CHROMATICITIES = 8


class ExrPart(NamedTuple):
    """A part, without its channels."""

    data: Window  #: its data window
    display: Window  #: its display window
    pixel_aspect: float  #: width by height of a pixel
    rate: Fraction | None  #: frames a second; None if they are not stated
    time_code: tuple[int, ...] | None  #: of the frame; None if no valid one is stated
    #: CIE x and y of red, green, blue and white; None if it does not state them
    chromaticities: tuple[float, ...] | None
    texts: Mapping[str, str]  #: text attributes of the first part
    view: str | None = None  #: its eye; None if it is not stated
    is_environment: bool = False  #: whether it shows all directions
    is_cube: bool = False  #: whether it shows them on the six faces of a cube

    @classmethod
    def of(cls, header: Mapping[str, Any], first: "ExrPart | None" = None) -> "ExrPart":
        """Read a header; the first part's rate, time code and primaries stand for missing ones."""
        chromaticities: Any = header.get("chromaticities")
        if not (isinstance(chromaticities, tuple) and len(chromaticities) == _CHROMATICITIES):
            chromaticities = first.chromaticities if first else None
        return cls(
            header_window(header["dataWindow"]),
            header_window(header["displayWindow"]),
            float(header["pixelAspectRatio"]),
            stated_rate(header) or (first.rate if first else None),
            stated_time_code(header) or (first.time_code if first else None),
            chromaticities,
            first.texts if first else {k: v for k, v in header.items() if isinstance(v, str)},
            header.get("view"),
            is_environment="envmap" in header,
            is_cube=header.get("envmap") == OpenEXR.ENVMAP_CUBE,
        )


def header_window(corners: tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]) -> Window:
    """A window of a header, which names the first and the last pixel."""
    (left, top), (right, bottom) = (map(int, corner) for corner in corners)
    return Window(left, top, right + 1, bottom + 1)


_DEEP = (OpenEXR.deepscanline, OpenEXR.deeptile)


class StoredChannel(NamedTuple):
    """One channel of a part."""

    pixels: AnyArray  #: (H, W) over the data window: float32, float16 or uint32
    part: ExrPart  #: what the header of its part states

    def over(self, window: Window) -> Float32Array:
        """The pixels of a window, (H, W) float32, NaN outside the data."""
        values, data = np.ascontiguousarray(self.pixels, np.float32), self.part.data
        for axis, size in enumerate((data.height, data.width)):  # chroma may have a half of each
            if values.shape[axis] <= size / 2:
                values = values.repeat(-(-size // values.shape[axis]), axis)
        left, top, (height, width) = data.left, data.top, values.shape
        return over_window(values, Window(left, top, left + width, top + height), window)


def read_exr_channels(
    source: Path | bytes, *, name: str | None = None, max_pixels: int = MAX_PIXELS
) -> dict[str, StoredChannel]:
    """All channels of a file, or of its content, by name.

    The name begins with that of their part if there are several.
    """
    label = name or str(source)
    channels: dict[str, StoredChannel] = {}
    problem = "is not an EXR file that can be read"
    try:
        others = cast("TextIO", _OtherThreads(sys.stdout))
        with _opened(source) as file, _LOCK, redirect_stdout(others):
            for part in OpenEXR.File(file, header_only=True).parts:
                if part.header["type"] in _DEEP:
                    raise InputError(f"{label} holds deep data", "flatten it first")
                for window in _WINDOWS:
                    size = header_window(part.header[window])
                    check_pixel_count(label, size.width, size.height, max_pixels)
            problem = "is damaged: its pixels cannot be read"
            file.seek(0)
            parts = OpenEXR.File(file, separate_channels=True).parts
        if not parts or not all(part.channels for part in parts):  # all that becomes of damage
            raise InputError(f"{label} {problem}", "copy it again")
        first = ExrPart.of(parts[0].header)
        for part in parts:
            layer = f"{part.header['name']}." if len(parts) > 1 else ""
            facts = ExrPart.of(part.header, first)
            for channel, content in part.channels.items():
                channels[layer + channel] = StoredChannel(content.pixels, facts)
    except OPENEXR_ERRORS as error:
        raise InputError(f"{label} {problem}", "copy it again") from error
    return channels


def write_exr(
    path: Path,
    channels: Mapping[str, AnyArray],
    texts: Mapping[str, str],
    rate: Fraction | None = None,
    *,
    pixel_aspect: float = 1.0,
    windows: tuple[Window, Window] | None = None,
    time_code: tuple[int, ...] | None = None,
) -> None:
    """Write one part, ZIP-compressed, of channels (H, W) float32 or float16 by name.

    Windows are the data window, which the channels cover, and the display window; None if both
    begin at (0, 0). Rate, pixel aspect and time code are those of ``Frame``.
    """
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "pixelAspectRatio": pixel_aspect,
        **texts,
    }
    if windows is not None:
        for name, (left, top, right, bottom) in zip(_WINDOWS, windows, strict=True):
            header[name] = (left, top), (right - 1, bottom - 1)  # the first and the last pixel
    if rate is not None:
        header["framesPerSecond"] = rate  # which OpenEXR stores as its rational
    if time_code is not None:
        header["timeCode"] = OpenEXR.TimeCode(*time_code)
    file = BytesIO()  # of a real file, OpenEXR swallows errors of the last writes
    OpenEXR.File(header, dict(channels)).write(file)
    path.write_bytes(file.getbuffer())


def read_exr_rate(path: Path) -> Fraction | None:
    """Frames a second that the header of the first part states; None if it does not."""
    try:
        with _opened(path) as file:  # of which OpenEXR prints nothing
            return stated_rate(OpenEXR.File(file, header_only=True).header())
    except OPENEXR_ERRORS as error:
        raise InputError(f"{path} is not an EXR file that can be read") from error


_DEPTHS = ("Z", "V", "Y", "R")
_MIST = re.compile(r"(?i)\bmist\b")  # of Blender, from 0 to 1


def choose_depth(
    file: str, channels: Mapping[str, StoredChannel], layer: str | None = None
) -> tuple[str | None, str | None]:
    """The channel that holds depth, in files of any program, and a warning if others may.

    That is ``Z``, else Z, V, Y or R of a layer called depth (Nuke's ``depth.Z``, Blender's
    ``ViewLayer.Depth.Z``), else a V or Y, else another layer's Z, V or Y, else an R, of the eye
    of the first part, as the image is. Layers of vectors are none of these.

    ``layer`` names the layer or part, or the last part of it, in upper or lower case. The channel
    and the warning are None if there is none.
    """
    names = list(channels)
    candidates = [n for n in names if last_part(n) in _DEPTHS and not is_of_vectors(n, names)]
    candidates.sort(key=_depth_rank)
    if layer is None:
        candidates = [n for n in candidates if not _MIST.search(n)]
    else:
        layers = {layer_of(name): name for name in reversed(candidates)}
        return _of_layer(file, layer, layers, "depth"), None
    hero = next((c.part.view for c in channels.values() if c.part.view), None)
    if not candidates:
        return None, None
    chosen = next((n for n in candidates if channels[n].part.view in (None, hero)), candidates[0])
    rank = _depth_rank(chosen)[:2]
    others = [name for name in candidates if name != chosen and _depth_rank(name)[:2] == rank]
    if not others:
        return chosen, None
    return chosen, Message(
        f"depth is that of channel {one_line(chosen)}",
        f"if it is in {one_line(', '.join(others[:_MAX_SHOWN]))}, give {{from_layer}}",
    )


_Found = TypeVar("_Found")


def _of_layer(file: str, layer: str, layers: Mapping[str, _Found], what: str) -> _Found:
    """The entry of a layer, by its whole name or the last part of it, in upper or lower case."""
    named = {prefix.removesuffix("."): entry for prefix, entry in layers.items()}
    key = layer.removesuffix(".").lower()
    same = [name for name in named if name and name.lower() == key]
    chosen = same or [name for name in named if name and last_part(name).lower() == key]
    if not chosen and key in _UNNAMED and "" in named:
        return named[""]
    if len(chosen) != 1:
        problem = "has several layers" if chosen else "has no layer"
        choices = one_line(", ".join(filter(None, chosen or named)))
        raise InputError(f"{file} {problem} {layer!r} with {what}", f"it has {choices}")
    return named[chosen[0]]


def is_of_vectors(name: str, names: Collection[str]) -> bool:
    """Whether a channel, of all ``names``, is of vectors (X, Y, Z) or texture places (U, V)."""
    layer = layer_of(name)
    return layer + "X" in names or layer + "U" in names


def layer_of(name: str) -> str:
    """Prefix of a channel's name: ``depth.`` of ``depth.Z``, or ""."""
    return name.removesuffix(last_part(name))


def last_part(name: str) -> str:
    """The part of a name after its last dot: ``Z`` of ``depth.Z``."""
    return name.rpartition(".")[2]


def _depth_rank(name: str) -> tuple[int, int, str]:
    last, layer = last_part(name), layer_of(name)
    signs = (name == "Z", "depth" in layer.lower(), last != "R" and not layer, last != "R", True)
    return signs.index(True), _DEPTHS.index(last), name


_NOTATIONS = (("r", "g", "b"), ("red", "green", "blue"))  # of colours, in any case
_UNNAMED = ("rgba", "rgb")  # what the layer without a name is called where layers are chosen
_IMAGES = ("", "rgba", "rgb", "combined", "beauty", "c", "ci", "main", "diffuse", "albedo")
"""Last parts of the names of layers that hold the image, the likeliest first."""
_DATA = re.compile(r"n|p|z|uv|.*(normal|position|depth|motion|velocity|crypto).*")
"""Last parts of the names of layers whose R, G and B may be no colours."""
_MAX_SHOWN = 4


def colour_channels(
    file: str, names: Sequence[str], layer: str | None = None
) -> tuple[tuple[str, ...], str | None]:
    """The channels of the image, and a warning if it may be another one.

    Without ``layer``, that is R, G and B, or Y, without a layer; else R, G and B of the layer or
    part whose name says that it is the image, else of one whose name does not say that it is
    data; of several, the first. R, G and B may be called red, green and blue, in any case.

    ``layer`` is as of :func:`choose_depth`; ``rgba`` and ``rgb`` are that without a name if none
    has these. Names are all channels of the file, in its order.
    """
    coloured = _coloured_layers(names)
    if layer is not None:
        grays = [n for n in names if last_part(n) == "Y" and not is_of_vectors(n, names)]
        channels = {layer_of(gray): (gray,) for gray in grays} | coloured
        return _of_layer(file, layer, channels, "R, G and B, or Y"), None
    if "Y" in names and "" not in coloured and not is_of_vectors("Y", names):
        return ("Y",), None
    if not coloured:
        choices = one_line(", ".join(names))
        raise InputError(f"{file} holds no image in R, G, B or Y", f"it has {choices}")
    ranks = {layer: _image_rank(layer) for layer in coloured}
    likely = [layer for layer, rank in ranks.items() if rank == min(ranks.values())]
    if len(likely) == 1:
        return coloured[likely[0]], None
    used, *others = (one_line(layer.removesuffix(".")) for layer in likely)
    more = f" and {len(others) - _MAX_SHOWN} others" if len(others) > _MAX_SHOWN else ""
    advice = f"if it is in {', '.join(others[:_MAX_SHOWN])}{more}, give {{layer}}"
    return coloured[likely[0]], Message(f"its layer {used} is used", advice)


def _coloured_layers(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """R, G and B of each layer that has them in one notation, by what precedes them."""
    coloured: dict[tuple[str, str], str] = {}
    for name in names:  # R precedes r, and r red, in a file, so R is used if there are several
        coloured.setdefault((layer_of(name), last_part(name).lower()), name)
    layers: dict[str, tuple[str, ...]] = {}
    for layer, colour in coloured:
        for notation in _NOTATIONS:
            keys = [(layer, other) for other in notation]
            if colour == notation[0] and coloured.keys() >= set(keys):
                layers.setdefault(layer, tuple(coloured[key] for key in keys))
    return layers


def _image_rank(layer: str) -> int:
    """Rank of a layer by its name; 0 is the likeliest to hold the image."""
    name = last_part(layer.removesuffix(".")).lower()
    if name in _IMAGES:
        return _IMAGES.index(name)
    return len(_IMAGES) + bool(_DATA.fullmatch(name))
