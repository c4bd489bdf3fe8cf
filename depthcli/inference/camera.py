"""The camera of an image, and the scale of a model's metres that were learned from another camera.

A network that was trained on one camera is right up to the ratio of focal lengths: that of the
image after resizing to that of the training, both in pixels of the network's input. Where
resizing stretches, the focal length is the geometric mean over both axes. Of a network that reacts
to a part of a change in apparent size, it is a power of the ratio, which the card states.
"""

import math
from dataclasses import replace

from depthcli.core.camera import (
    HFOV_DEG,
    CameraSource,
    Intrinsics,
    focal_px_of_crop,
    focal_px_of_hfov,
)
from depthcli.core.types import DepthKind, Frame
from depthcli.inference.transforms import Layout
from depthcli.models.card import CameraSpec, ModelCard


def metric_camera(card: ModelCard) -> CameraSpec | None:
    """The camera that a model's metres are for; None if it is not known, or the kind not metric."""
    return card.camera if card.output.kind is DepthKind.METRIC else None


def focal_warnings(card: ModelCard, camera: Intrinsics) -> tuple[str, ...]:
    """A warning if a given focal length does not scale the model's depth; else none."""
    if not camera.has_focal or metric_camera(card) is not None:
        return ()
    no_camera = f"model {card.name!r} gives no metres of a known camera"
    return (f"{no_camera}: the focal length is used for point clouds, and does not scale depth",)


def intrinsics_of(card: ModelCard, frame: Frame, camera: Intrinsics) -> Intrinsics:
    """The camera of an image, in its pixels.

    Its focal length is the given one, else that of the image's EXIF, else that of the camera that
    the model learned; None if none is known.
    """
    aspect = frame.pixel_aspect if camera.pixel_aspect is None else camera.pixel_aspect
    width, height = frame.display_size_px
    camera = replace(camera, pixel_aspect=aspect)
    focal_px, source = camera.focal_for(width, height), CameraSource.OPTION
    if focal_px is None and frame.focal_35mm is not None:
        exif = Intrinsics(pixel_aspect=aspect, focal_35mm=frame.focal_35mm)
        focal_px, source = exif.focal_for(width, height), CameraSource.EXIF
    learned = metric_camera(card)
    if focal_px is None and learned is not None:
        # docs/accuracy.md has measurements of alternatives to the largest crop.
        spec = card.input
        own_size = spec.width, spec.height / spec.pixel_aspect
        own_px = learned.focal_px_at(spec.width)
        focal_px = focal_px_of_crop(own_px, own_size, (width * aspect, height)) / aspect
        source = CameraSource.CARD
    return Intrinsics(
        focal_px,
        centre_px=camera.centre_for(width, height),
        pixel_aspect=aspect,
        source=None if focal_px is None else source,
        scale=camera.scale,
    )


def with_own_view(camera: Intrinsics, hfov_deg: float | None, width: int) -> Intrinsics:
    """A camera of an image with the network's own field of view, if its own is not known.

    Estimates out of the range of fields of view are not used.
    """
    is_known = camera.source not in {None, CameraSource.CARD}
    if is_known or hfov_deg is None or not HFOV_DEG.holds(hfov_deg):
        return camera
    return replace(camera, focal_px=focal_px_of_hfov(hfov_deg, width), source=CameraSource.MODEL)


def metric_scale(card: ModelCard, frame: Frame, layout: Layout, camera: Intrinsics) -> float:
    """The factor from the network's metres to those of an image's camera; 1 for other depth.

    The frame has the pixel aspect of its camera, which is that of :func:`intrinsics_of`.
    """
    learned = metric_camera(card)
    if learned is None or camera.focal_px is None:
        return 1.0
    across = layout.width / frame.width
    down = layout.height / frame.height * frame.pixel_aspect
    factor = math.sqrt(across * down)
    if layout.is_padded:
        # One axis is filled. On the other, rounding to whole pixels matters for a narrow strip.
        root = math.sqrt(card.input.pixel_aspect)
        factor = min(across * root, down / root)
    if learned.along == "width":
        factor = across * math.sqrt(card.input.pixel_aspect)
    elif learned.along == "mean":
        factor = (across + down) / 2
    learned_px = learned.focal_px_at(card.input.width)
    ratio = camera.focal_px * factor / (learned_px * math.sqrt(card.input.pixel_aspect))
    return float(ratio**learned.exponent)
