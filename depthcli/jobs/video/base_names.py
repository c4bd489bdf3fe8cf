"""The name that the outputs of a video or an image sequence begin with."""

import hashlib
import os
from contextlib import suppress
from pathlib import Path, PurePath

from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.jobs.namesakes import comparable, names_near
from depthcli.jobs.naming import output_bases
from depthcli.video.frame_source import is_sequence
from depthcli.video.number_pattern import number_in, pattern_of, sequence_name
from depthcli.video.sequence_files import is_sequence_picture, listed_names


def video_base(source: Path | None) -> str:
    """The name of a video's outputs, without suffix; ``source`` is None for standard input.

    An image sequence counts as one file, ``plate.exr`` for ``plate.%04d.exr`` and for a folder
    ``plate`` of such pictures. As of any file, its suffix is kept if another input of its folder
    has its stem. A checksum follows if another sequence has this suffix, too.
    """
    if source is None:
        return output_bases([None])[0]
    source, name = _as_one_file(source)
    (base,) = output_bases([source.with_name(name)])
    others = {comparable(other) for other in _sequences(source, name)}
    if comparable(name) in others:
        return f"{name}.{hashlib.sha256(os.fsencode(source.name)).hexdigest()[:8]}"
    return name if others and base == PurePath(name).stem else base


def _as_one_file(source: Path) -> tuple[Path, str]:
    """The input, and the name of the one file that it counts as."""
    if not is_sequence(source):
        return source, source.name
    if source.is_dir():
        source = source.resolve()  # "." has no name
        with suppress(OSError):  # which reading it reports
            return source, source.name + _picture_suffix(source)
    return source, sequence_name(source.name)


def _sequences(source: Path, name: str) -> list[str]:
    """The other sequences in the folder of an input that count as files with the stem of a name."""
    folder, stem = source.parent, PurePath(name).stem
    firsts: dict[str, str] = {}
    try:
        for one in sorted(filter(is_sequence_picture, names_near(folder, [name]))):
            pattern = pattern_of(PurePath(one).stem)
            if pattern is not None and number_in(source.name, one) is None:
                other = sequence_name(pattern + PurePath(one).suffix)
                firsts.setdefault(other, one)
        suffix = "" if source.name == stem else _picture_suffix(folder / stem)
    except OSError:  # what cannot be listed has no sequence that can be read
        return []
    found = [
        other
        for other, first in firsts.items()
        if comparable(PurePath(other).stem) == comparable(stem)
        and not is_own_picture(folder / first)
    ]
    return [*found, stem + suffix] if suffix else found


def _picture_suffix(folder: Path) -> str:
    """The suffix of the first picture in a folder; empty without one, or if depthcli wrote it.

    Raises:
        OSError: the folder cannot be listed.
    """
    names = listed_names(folder) if folder.is_dir() else ()
    first = next(filter(is_sequence_picture, names), None)
    return "" if first is None or is_own_picture(folder / first) else PurePath(first).suffix
