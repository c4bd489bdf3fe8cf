"""Files with known depth from the command line."""

from collections.abc import Sequence

from depthcli.cli.arguments.camera import parse_anchor
from depthcli.core.camera import Anchor
from depthcli.errors import UsageError
from depthcli.io.depth.anchor_files import AnchorFiles
from depthcli.io.storage.remote import RemotePath, path_of


def choose_anchors(
    points: Sequence[str] | None,
    path: str | None,
    scale: float | None,
    *,
    is_folder: bool = False,
) -> AnchorFiles | tuple[Anchor, ...]:
    """The files of ``--anchors``, or the points of ``--anchor``.

    Args:
        points: the points of ``--anchor``.
        path: the file, or a folder.
        scale: units per metre of the files.
        is_folder: whether it has to be a folder with a file for each picture.

    Raises:
        UsageError: the options contradict each other, or the path is a file in place of a folder.
    """
    check_anchors(points, path, scale)
    if path is None:
        return tuple(map(parse_anchor, points or ()))
    place = path_of(path)
    if is_folder and not isinstance(place, RemotePath) and not place.is_dir():
        raise UsageError(
            f"--anchors {place} is not a folder; for 'batch', name one with a file for each picture"
        )
    if not is_folder and not isinstance(place, RemotePath) and place.is_dir():
        raise UsageError(f"--anchors {place} is a folder; name a file, or use 'depthcli batch'")
    return AnchorFiles(path, scale)


def check_anchors(points: Sequence[str] | None, path: str | None, scale: float | None) -> None:
    """Refuse options of :func:`choose_anchors` that do not fit together.

    Raises:
        UsageError: there are such options.
    """
    for point in points or ():
        parse_anchor(point)
    if points and path is not None:
        raise UsageError("give --anchor or --anchors, not both")
    if path is None and scale is not None:
        raise UsageError("--anchors-scale is for --anchors; give both or neither")
