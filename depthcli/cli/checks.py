"""Refusing options that none of the output formats uses."""

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any

import typer

from depthcli.cli.options import png_scale_range
from depthcli.errors import UsageError
from depthcli.io.formats.table import FORMATS, Format
from depthcli.io.listing.folder import is_exr
from depthcli.io.storage.paths import RemotePath, path_of, safe_name
from depthcli.video.numbering import is_pattern
from depthcli.video.sequence import find_pictures

PICTURE_OPTIONS = {str(name): facts.parameters for name, facts in FORMATS.items()}
"""The options that each format uses, by parameter name."""


def refuse_unused(
    context: Any,  # noqa: ANN401 - typer's own
    formats: Collection[str],
    used_by: Mapping[str, Collection[str]],
) -> None:
    """Refuse an option on the command line that no output format uses.

    Options of a profile, which serves several runs, may be unused.

    Raises:
        UsageError: there is such an option.
    """
    for name, word in given_options(context).items():
        users = [format_ for format_, options in used_by.items() if name in options]
        if users and set(users).isdisjoint(formats):
            raise UsageError(
                f"{word} is for {_alternatives(users)}, and only {' and '.join(formats)} would be "
                "written; remove it, or choose another format"
            )


def _alternatives(names: Sequence[str]) -> str:
    """``a``, ``a or b``, ``a, b or c``."""
    return " or ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def given_options(context: Any) -> dict[str, str]:  # noqa: ANN401 - typer's own
    """The options given on the command line: parameter name -> option."""
    parameters = {}
    for parameter in context.command.params:
        is_off = parameter.secondary_opts and context.params.get(parameter.name) is False
        parameters[str(parameter.name)] = parameter.secondary_opts if is_off else parameter.opts
    return {
        name: max(words, key=len) for name, words in parameters.items() if is_given(context, name)
    }


def is_given(context: Any, name: str) -> bool:  # noqa: ANN401 - typer's own
    """Whether a parameter is given on the command line, not only in a profile."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


_FOR_EXR = ("exposure", "layer")
_STDIN = "-"


def refuse_for_pictures(context: Any, pictures: Sequence[str]) -> None:  # noqa: ANN401 - typer's own
    """Refuse ``--white-level`` if all pictures are EXR, ``--exposure`` and ``--layer`` if none is.

    Raises:
        UsageError: one is given on the command line, and they are.
    """
    given = given_options(context)
    if not pictures or given.keys().isdisjoint({"white_level", *_FOR_EXR}):
        return
    name, are_exr = safe_name(pictures[0]), [is_exr(picture) for picture in pictures]
    if "white_level" in given and all(are_exr):
        raise UsageError(
            f"--white-level is for 16-bit PNG and TIFF, and {name} is an EXR, whose white is 1; "
            "leave it out"
        )
    for option in _FOR_EXR:
        if option in given and not any(are_exr) and _STDIN not in pictures:
            raise UsageError(f"{given[option]} is for EXR, and {name} is none; leave it out")


def refuse_for_frames(context: Any, file: str) -> None:  # noqa: ANN401 - typer's own
    """As :func:`refuse_for_pictures`, for the pictures of an image sequence.

    Raises:
        UsageError: an option does not apply to any.
        InputError: there is no such sequence.
    """
    if not given_options(context).keys().isdisjoint({"white_level", *_FOR_EXR}):
        refuse_for_pictures(context, [str(frame.path) for frame in find_pictures(path_of(file))])


def refuse_for_folder(context: Any) -> None:  # noqa: ANN401 - typer's own
    """Refuse ``--exposure`` and ``--layer`` for a batch of a folder, in which EXR are skipped.

    Raises:
        UsageError: one is given on the command line.
    """
    given = given_options(context)
    for option in _FOR_EXR:
        if option in given:
            raise UsageError(
                f"{given[option]} is for EXR, which batch reads only from a list; name it with "
                "--files, or leave the option out"
            )


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


FileArgument = Annotated[
    str,
    typer.Argument(metavar="FILE", help="Depth file: 16-bit PNG, EXR, NPY or depth video (.mkv)."),
]
ScaleOption = Annotated[
    float | None,
    typer.Option(
        callback=png_scale_range,
        help="Units per metre of a PNG or video (default: from the file, else 1000), or NPY of "
        "integers.",
    ),
]
FrameOption = Annotated[
    int | None, typer.Option(min=0, help="The frame of a depth video (.mkv) to read, from 0.")
]
