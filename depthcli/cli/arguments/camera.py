"""What the user knows of the camera and the scene, and the depth that follows."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from depthcli.cli.arguments.points import parse_anchors
from depthcli.errors import InputError, UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.core.anchor import Anchor
    from depthcli.core.types import DepthMap


class Camera(NamedTuple):
    """What the user knows of the camera and the scene.

    Attributes:
        focal_px: focal length in pixels of the picture.
        hfov_deg: horizontal field of view in degrees.
        anchors: points of known depth.
    """

    focal_px: float | None
    hfov_deg: float | None
    anchors: tuple[Anchor, ...]

    def fitted(self, depth: DepthMap) -> DepthMap:
        """The depth map through the anchors, if there are any.

        Raises:
            InputError: an anchor does not fit this picture.
        """
        if not self.anchors:
            return depth
        from depthcli.core.scaling import fit_anchors

        try:
            return fit_anchors(depth, self.anchors)
        except UsageError as error:  # an anchor that does not fit this picture may fit the next
            raise InputError(str(error)) from error


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
