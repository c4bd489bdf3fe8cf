"""Formats and file names of a video's outputs, as ``--out`` and ``--format`` name them."""

from collections.abc import Sequence
from pathlib import Path

from depthcli.errors import UsageError
from depthcli.io.formats.table import Format, format_of
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.jobs.naming import is_folder
from depthcli.video.formats import (
    SEQUENCES,
    VIDEO_FORMATS,
    VideoFormat,
    frame_suffix,
    sequence_of,
    video_format_of,
    video_stem_of,
)
from depthcli.video.number_pattern import base_name, check_folders, is_pattern

STDIO = "-"
DEFAULT_FORMATS = (VideoFormat.MKV, VideoFormat.MP4)


def video_formats(output: str | None, asked: Sequence[VideoFormat]) -> tuple[VideoFormat, ...]:
    """The formats to write: the requested ones, else that of the output's suffix, else the default.

    Raises:
        UsageError: the output is empty, or a file whose suffix is of no format, or JSON is the only
            format.
    """
    if output == "":
        raise UsageError("-o is empty; name a file or a folder, or omit -o")
    if output is not None and is_pattern(path_of(output).name) and not is_folder(output):
        chosen: tuple[VideoFormat, ...] = (_format_of_pattern(output, asked),)
    elif asked:
        chosen = tuple(dict.fromkeys(asked))
    elif output == STDIO:
        chosen = (VideoFormat.MKV,)
    elif output is None or is_output_folder(output):
        chosen = DEFAULT_FORMATS
    elif (found := video_format_of(output) or _sequence_named(output)) is not None:
        chosen = (found,)
    else:
        raise UsageError(
            f"--out {safe_name(output)} has no suffix that selects a format; use .mkv, .mp4, .webm "
            f"or .mov, give --format, or end the name in '/' for a folder"
        )
    if set(chosen) == {VideoFormat.JSON}:
        raise UsageError("json only describes other outputs; give another --format with it")
    return chosen


def is_output_folder(output: str) -> bool:
    """Whether ``--out`` names a folder: it exists as one, ends in a separator, or has no suffix."""
    return is_folder(output) or not path_of(output).suffix


def file_names(
    output: Path, formats: Sequence[VideoFormat], wanted: Sequence[VideoFormat]
) -> dict[VideoFormat, str]:
    """File names for an output that is no folder: a pattern, one file, or the stem of the names.

    A name without the suffix of a format is a stem, also of a single file.

    Args:
        output: the path.
        formats: what is to be written.
        wanted: the same, and JSON if a sidecar is.

    Raises:
        UsageError: the suffix is of another format, or the format is one file per frame.
    """
    main = [which for which in formats if which is not VideoFormat.JSON]
    if is_pattern(output.name):
        names: dict[VideoFormat, str] = {main[0]: output.name}
        sidecar = base_name(output.stem)
    elif len(main) == 1 and (video_format_of(output) or format_of(output)):
        _check_suffix(output, main[0])
        names, sidecar = {main[0]: output.name}, output.stem
    else:
        stem = video_stem_of(output)
        return {which: stem + VIDEO_FORMATS[which].suffix for which in wanted}
    return names | ({VideoFormat.JSON: f"{sidecar}.json"} if VideoFormat.JSON in wanted else {})


def _check_suffix(output: Path, which: VideoFormat) -> None:
    if which in SEQUENCES:
        name = output.with_name(f"{output.stem}.%04d{frame_suffix(which)}")
        raise UsageError(
            f"--out {output} is one file and {which} writes one per frame; give --out {name}, or "
            "name a folder"
        )
    if video_format_of(output) is not which:
        raise UsageError(
            f"--out {output} does not end in .{which}; the suffix has to match the format"
        )


def _format_of_pattern(output: str, asked: Sequence[VideoFormat]) -> VideoFormat:
    """The format of the files of a pattern such as ``depth.%04d.exr``."""
    check_folders(path_of(output))
    found = _sequence_named(output)
    if found is None or set(asked) - {found}:
        raise UsageError(
            f"--out {output} is a pattern for numbered files: end it in .png, .exr or .npy, with "
            "no other --format"
        )
    return found


def _sequence_named(output: str) -> VideoFormat | None:
    """The format of numbered files that a name's suffix chooses; None if it chooses none."""
    if format_of(output) is Format.PREVIEW:
        raise UsageError(
            f"--out {safe_name(output)} is the name of a preview, and previews of a video are "
            "videos; name a .mp4, .webm or .mov file"
        )
    return sequence_of(output)
