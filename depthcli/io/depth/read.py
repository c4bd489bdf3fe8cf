"""Reading depth files of depthcli and of other tools, in every format that has a reader."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from typing import Self

import numpy as np
import numpy.typing as npt

from depthcli.core.types import DepthKind, DepthMap, Frame, displayed_depth
from depthcli.errors import InputError, Message, UsageError
from depthcli.io.depth.metadata import kind_named, provenance_of
from depthcli.io.depth.scale import DepthScale
from depthcli.io.formats.sidecar import FileMetadata
from depthcli.io.formats.table import READABLE_SUFFIXES, readable_format, reader_of
from depthcli.io.storage.paths import path_of


@dataclass(frozen=True, slots=True)
class DepthReadOptions:
    """Statements of the user about a depth file."""

    #: units per metre of integers; None for what the file states
    scale: float | None = None
    kind: DepthKind | None = None  #: kind of the depth of a file that states none; None for metric
    #: units per metre of the integers of a file that states none; None for millimetres in PNG
    unstated_scale: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StoredDepth:
    """A depth map that was read from a file.

    Attributes:
        name: the file.
        depth: the map, of an EXR over its data window.
        metadata: metadata of the file and its sidecar, texts by name.
        scale: of integers; None if the file holds floats, or is normalized.
        frame: without an image; has the windows, the shape of pixels, the rate and the time code
            of an EXR.
        channel: of an EXR, that the depth is read from; None for other files.
        warnings: one line each.
    """

    name: str
    depth: DepthMap
    metadata: Mapping[str, str]
    scale: DepthScale | None = None
    frame: Frame = field(default_factory=lambda: Frame(np.zeros((1, 1), np.uint8)))
    channel: str | None = None
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        path: Path,
        values: npt.NDArray[np.float32],
        metadata: FileMetadata,
        options: DepthReadOptions,
        scale: DepthScale | None = None,
    ) -> Self:
        """Depth of a file: values, (H, W) float32, and what is stated about them.

        Raises:
            InputError: there is no pixel.
        """
        if not values.size:
            raise InputError(f"{path} has no pixels")
        depth = DepthMap(values, stated_kind(metadata, options), provenance_of(metadata.texts))
        return cls(str(path), depth, metadata.texts, scale, warnings=metadata.warnings)

    @property
    def displayed(self) -> DepthMap:
        """The map, of an EXR in its display window."""
        return displayed_depth(self.depth, self.frame.windows)

    def warnings_with_scale(self, option: str) -> tuple[str, ...]:
        """The warnings, and one if the scale is assumed, which names the option that states it."""
        if self.scale is None or self.scale.source != "assumed":
            return self.warnings
        problem = f"{self.name} states no scale, so millimetres are assumed"
        return (*self.warnings, Message(problem, f"{{{option}}} states another"))


def stated_kind(metadata: FileMetadata, options: DepthReadOptions) -> DepthKind:
    """The kind that a file states, else the user."""
    if "kind" in metadata.texts or options.kind is None:
        return kind_named(metadata.texts.get("kind"))
    return options.kind


def read_stored_depth(
    path: str | Path,
    *,
    png_scale: float | None = None,
    kind: DepthKind | None = None,
    unstated_scale: float | None = None,
) -> StoredDepth:
    """Depth of a file in a format that is read, chosen by its suffix.

    Args:
        path: the file.
        png_scale: units per metre of a PNG, None for what the file states, or millimetres; or of
            integers in an NPY file, which need it to be metric.
        kind: kind of the depth of a file that states none; None for metric.
        unstated_scale: as ``png_scale``, but only for a file of integers that states none.

    Returns:
        (H, W); NaN where there is no depth. Its provenance is what the file or the sidecar beside
        it states of model, camera, anchors and orientation.

    Raises:
        InputError: missing, damaged, without depth, or metric integers without a scale.
        UsageError: a scale for a file of floats, which are metres.
    """
    path = path_of(path)
    which = readable_format(path)
    if which is None:
        raise InputError(
            f"{path} is not a depth file ({', '.join(READABLE_SUFFIXES)}, .mkv)",
            "'depthcli predict' and 'depthcli video' estimate the depth of pictures and videos",
        )
    options = DepthReadOptions(png_scale, kind, unstated_scale)
    stored: StoredDepth = reader_of(which)(path, options)
    if png_scale is not None and stored.scale is None:
        raise UsageError(f"a scale is for integers, and {path} holds none", "remove it")
    return stored


def read_metadata(path: Path) -> Mapping[str, str]:
    """Metadata of a depth file and its sidecar, texts by name; a PNG is not decoded for it.

    Raises:
        InputError: missing or damaged.
    """
    if path.suffix.lower() == ".png":
        texts: Mapping[str, str] = resolve_name("depthcli.io.formats.png16:read_metadata")(path)
        return texts
    return read_stored_depth(path).metadata
