"""Refusing options for pictures of another kind than the inputs; a profile may have them."""

from collections.abc import Sequence
from typing import Any

from depthcli.cli.arguments.unused import given_options
from depthcli.errors import UsageError
from depthcli.io.listing.folder import is_exr
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.video.sequence_files import find_pictures

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
