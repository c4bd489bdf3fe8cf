"""What the formats of points and meshes share: their options, and the camera."""

from dataclasses import dataclass

from depthcli.core.camera import CameraSource, focal_px_of_hfov, hfov_deg
from depthcli.core.surface import Surface, surface_of
from depthcli.core.types import DepthMap, Provenance
from depthcli.errors import Message, OutputError, UsageError

_NYU_HFOV_DEG = 63.3  # assumed if the map states no focal length


@dataclass(frozen=True, slots=True)
class SurfaceWriter:
    """Options of the formats that show a map in space."""

    stride: int = 1  #: every n-th pixel of every n-th row
    max_depth_m: float | None = None  #: pixels beyond are left out; None for no limit
    keep_edges: bool = False  #: keep pixels between near and far at smeared edges

    def __post_init__(self) -> None:
        """Check the options."""
        if self.stride < 1:
            raise UsageError(f"a stride of {self.stride} is not 1 or more", option="stride")

    def surface(self, depth: DepthMap) -> tuple[Surface, tuple[Message, ...]]:
        """The points of a map by its camera, and warnings about that."""
        focal_px, warnings = camera_of(depth)
        surface = surface_of(
            depth,
            focal_px,
            stride=self.stride,
            max_depth_m=self.max_depth_m,
            keep_edges=self.keep_edges,
        )
        if not surface.valid.any():
            raise OutputError("no point is left", "raise {max_depth_m}, or lower {stride}")
        return surface, warnings


def camera_of(depth: DepthMap) -> tuple[float, tuple[Message, ...]]:
    """The focal length of a map in pixels, and a warning if it is assumed."""
    if not depth.is_metric:
        raise OutputError(
            f"a point in space needs metres, and {depth.kind} depth has none",
            "fit it to known depth with {anchors}",
        )
    source = depth.provenance or Provenance()
    if source.is_cropped:
        raise OutputError(
            "the focal length of the depth is for an image of another size",
            "give {focal_px} or {hfov} of this one",
        )
    focal_px = source.focal_px or focal_px_of_hfov(_NYU_HFOV_DEG, depth.width)
    is_known = source.focal_px and source.camera_source is not CameraSource.CARD
    if is_known or source.projection.is_other:
        return focal_px, ()
    assumed = f"an hfov of {hfov_deg(focal_px, depth.width):.3g}° is assumed"
    advice = "give the focal length or the field of view"
    return focal_px, (Message(f"no focal length is known; {assumed}", advice),)
