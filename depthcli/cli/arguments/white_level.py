"""Refusing ``--white-level`` for EXR, whose white is 1; a profile may have it."""

from collections.abc import Sequence
from typing import Any

from depthcli.cli.arguments.unused import is_given
from depthcli.errors import UsageError
from depthcli.io.listing.folder import is_exr
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.video.sequence_files import find_pictures


def refuse_for_exr(context: Any, pictures: Sequence[str]) -> None:  # noqa: ANN401 - typer's own
    """Refuse it if all pictures are EXR.

    Raises:
        UsageError: it is given on the command line, and they are.
    """
    if is_given(context, "white_level") and pictures and all(map(is_exr, pictures)):
        raise UsageError(
            f"--white-level is for 16-bit PNG and TIFF, and {safe_name(pictures[0])} is an EXR, "
            "whose white is 1; leave it out"
        )


def refuse_for_exr_frames(context: Any, file: str) -> None:  # noqa: ANN401 - typer's own
    """Refuse it if all pictures of an image sequence are EXR.

    Raises:
        UsageError: it is given on the command line, and they are.
        InputError: there is no such sequence.
    """
    if is_given(context, "white_level"):
        refuse_for_exr(context, [str(frame.path) for frame in find_pictures(path_of(file))])
