"""Writing a depth map in the format of a file's suffix."""

from collections.abc import Mapping
from pathlib import Path

from depthcli.core.types import DepthMap, Frame
from depthcli.errors import UsageError
from depthcli.io.exr.layers import depth_channel
from depthcli.io.formats.table import (
    FILE_SUFFIXES,
    FORMATS,
    Format,
    format_of,
    is_own,
    writer_class,
)
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.guard import Guard


def write_depth(
    depth: DepthMap,
    path: Path,
    frame: Frame | None,
    options: Mapping[str, object],
    *,
    overwrite: bool = False,
) -> tuple[str, ...]:
    """Write a map atomically; return warnings, one line each.

    Missing folders are created; the file of ``frame``, the picture for formats that show it, is
    never replaced, and a file that depthcli did not write only with ``overwrite``. Options are
    png_scale, exr_channel and half; None for the default.

    Raises:
        OutputError: it cannot be written, or the map cannot be expressed in the format.
        UsageError: the suffix chooses no format, or an option is of another one.
    """
    name = format_of(path)
    if name is None:
        raise UsageError(
            f"{path} has no suffix that selects a format; use {', '.join(FILE_SUFFIXES)}"
        )
    writer = writer_class(name)(**_checked_options(name, options))
    inputs = () if frame is None or frame.path is None else (frame.path,)
    guard = Guard.of(is_own, inputs, overwrite=overwrite)
    with atomic_path(path, guard=guard) as temporary:
        return writer.write(depth, temporary, frame)


def _checked_options(name: Format, options: Mapping[str, object]) -> dict[str, object]:
    """The given options, all of which are the writer's."""
    given = {option: value for option, value in options.items() if value is not None}
    for option in given:
        if option not in FORMATS[name].options:
            owner = next(facts for facts in FORMATS.values() if option in facts.options)
            raise UsageError(f"{option} is for {owner.suffix}, not for {FORMATS[name].suffix}")
    channel = given.get("exr_channel")
    if channel is not None and depth_channel([str(channel)]) is None:
        raise UsageError(f"exr_channel {channel!r} would not be read as depth; use Y, Z or depth.Z")
    return given
