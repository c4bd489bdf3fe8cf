"""The focal lengths that depth images state, if depthcli predicted them."""

from collections.abc import Sequence
from pathlib import Path

from depthcli.errors import DatasetError, InputError
from depthcli.io.depth.metadata import positive_number
from depthcli.io.depth.read import read_metadata


def stated_focal_px(depths: Sequence[Path]) -> tuple[float, ...]:
    """Focal length that each depth image is for, in its own pixels; empty if none states it.

    Raises:
        DatasetError: some state it and others do not, or a file cannot be read.
    """
    try:
        found = {path: positive_number(read_metadata(path).get("focal_px")) for path in depths}
    except InputError as error:
        raise DatasetError(str(error)) from error
    silent = [path for path, focal_px in found.items() if focal_px is None]
    if 0 < len(silent) < len(found):
        raise DatasetError(
            f"{silent[0]} states no focal length, but other depth images beside it do: add "
            "cameras.csv (id,focal_px) with that of each pair"
        )
    return tuple(focal_px for focal_px in found.values() if focal_px is not None)
