"""Arguments of ``convert``: those of a file or of a folder, and those that each format uses."""

from typing import Any

from depthcli.cli.arguments.unused import PICTURE_OPTIONS, given_options
from depthcli.errors import UsageError
from depthcli.io.formats.table import Format
from depthcli.io.storage.remote import RemotePath, path_of, safe_name
from depthcli.video.number_pattern import is_pattern

_FOLDER_OPTIONS = ("include", "exclude", "workers")
_FILE_OPTIONS = ("frame", "picture")
_PICTURE_FORMATS = (Format.PLY, Format.PREVIEW)
_CAMERA_OPTIONS = ("focal_px", "hfov", "calibration", "rectified")


def _used_options(name: str) -> tuple[str, ...]:
    """The options that a format uses, by parameter name."""
    camera = _CAMERA_OPTIONS if Format(name).facts.has_camera else ()
    return (*PICTURE_OPTIONS[name], *camera, *(("picture",) if name in _PICTURE_FORMATS else ()))


USED_OPTIONS = {name: _used_options(name) for name in PICTURE_OPTIONS}
"""The options that each format uses, by parameter name."""


def check_arguments(context: Any) -> None:  # noqa: ANN401 - typer's own
    """Check that the arguments are those of a file or those of a folder.

    Raises:
        UsageError: they are neither.
    """
    source, target, output = (context.params[name] for name in ("source", "target", "output"))
    name, place = safe_name(source), path_of(source)
    if target is not None and output is not None:
        raise UsageError("give OUT for a file, or --out for a folder, not both")
    if output is not None and not place.is_dir():
        is_video = place.suffix.lower() == ".mkv"
        other = "a pattern such as depth.%04d.exr" if is_video else "OUT"
        raise UsageError(f"{name} is not a folder; for a file, give {other} without --out")
    if output is None and not isinstance(place, RemotePath) and place.is_dir():
        raise UsageError(f"{name} is a folder; give --out DIR and --format")
    if output is None and target is None:
        raise UsageError(f"name the output: depthcli convert {name} OUT")
    unused, kind = (_FILE_OPTIONS, "file") if output is not None else (_FOLDER_OPTIONS, "folder")
    is_parallel = target is not None and is_pattern(path_of(target).name)
    for option, word in given_options(context).items():
        if option in unused and not (option == "workers" and is_parallel):
            raise UsageError(f"{word} is for a {kind}; remove it")


def folder_format(given: Format | None) -> Format:
    """The format of a folder's outputs, whose names choose none.

    Raises:
        UsageError: it is not given.
    """
    if given is None:
        raise UsageError("name the format of the outputs, for example --format exr")
    return given
