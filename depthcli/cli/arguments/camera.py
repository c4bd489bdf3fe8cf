"""The camera, as the command line says it."""

from collections.abc import Sequence

from depthcli.cli.arguments.points import parse_anchors
from depthcli.core.camera import Camera
from depthcli.errors import UsageError


def choose_camera(
    focal_px: float | None, hfov_deg: float | None, anchors: Sequence[str] | None
) -> Camera:
    """The camera that the options describe.

    Raises:
        UsageError: they contradict each other, or an anchor is not X,Y,METRES.
    """
    if focal_px is not None and hfov_deg is not None:
        raise UsageError("give --focal-px or --hfov, not both")
    return Camera(focal_px, hfov_deg, parse_anchors(anchors or ()))
