"""The camera of a picture, and the scale of a model's metres that were learned from another camera.

A network that was trained on one camera is right up to the ratio of focal lengths: that of the
picture after resizing to that of the training, both in pixels of the network's input. Where
resizing stretches, the focal length is the geometric mean over both axes.
"""

import math
from typing import NamedTuple

from depthcli.core import scaling
from depthcli.core.camera import Lens
from depthcli.core.types import CameraSource, DepthKind, Frame
from depthcli.inference.preprocess import Layout
from depthcli.models.card import ModelCard
from depthcli.models.card_specs import CameraSpec, InputSpec


class PictureCamera(NamedTuple):
    """The camera of one picture."""

    focal_px: float  #: focal length in pixels of the picture, in widths of them
    source: CameraSource  #: where that comes from
    scale: float = 1.0  #: what the network's metres are multiplied by


def metric_camera(card: ModelCard) -> CameraSpec | None:
    """The camera that a model's metres are for; None if it is not known, or the kind not metric."""
    return card.camera if card.output.kind is DepthKind.METRIC else None


def focal_warnings(card: ModelCard, lens: Lens) -> tuple[str, ...]:
    """A warning if a given focal length does not scale the model's depth; else none."""
    if (lens.focal_px is None and lens.hfov_deg is None) or metric_camera(card) is not None:
        return ()
    no_camera = f"model {card.name!r} gives no metres of a known camera"
    return (f"{no_camera}: the focal length is used for point clouds, and does not scale depth",)


def camera_of(card: ModelCard, frame: Frame, layout: Layout, lens: Lens) -> PictureCamera | None:
    """The camera of a picture; None if none is known.

    That of the given lens, else the one in its EXIF, else that of the card.
    """
    known = _stated_camera(frame, lens)
    learned = metric_camera(card)
    if learned is None:
        return known
    camera = known or _assumed(card.input, learned, frame)
    seen_px = camera.focal_px * _resize_factor(card.input, frame, layout)
    return camera._replace(scale=seen_px / learned_focal_px(card.input, learned))


def learned_focal_px(spec: InputSpec, camera: CameraSpec) -> float:
    """The focal length that a model learned, in pixels of its input."""
    return scaling.focal_px_of_hfov(camera.hfov_deg, spec.width) * math.sqrt(spec.pixel_aspect)


def _resize_factor(spec: InputSpec, frame: Frame, layout: Layout) -> float:
    """Pixels of the network's input for a pixel's width, the geometric mean of both axes."""
    across = layout.width / frame.width
    down = layout.height / frame.height * frame.pixel_aspect
    if not layout.is_padded:
        return math.sqrt(across * down)
    # One axis is filled. On the other, rounding to whole pixels matters for a narrow strip.
    root = math.sqrt(spec.pixel_aspect)
    return min(across * root, down / root)


def _stated_camera(frame: Frame, lens: Lens) -> PictureCamera | None:
    if lens.focal_px is not None:
        return PictureCamera(float(lens.focal_px), CameraSource.OPTION)
    width, height = frame.display_size_px
    if lens.hfov_deg is not None:
        in_px = scaling.focal_px_of_hfov(float(lens.hfov_deg), width)
        return PictureCamera(in_px, CameraSource.OPTION)
    if frame.focal_35mm is not None:
        aspect = frame.pixel_aspect
        in_px = scaling.focal_px_of_35mm(frame.focal_35mm, width * aspect, height)
        return PictureCamera(in_px / aspect, CameraSource.EXIF)
    return None


def _assumed(spec: InputSpec, camera: CameraSpec, frame: Frame) -> PictureCamera:
    """The camera that a model learned, for a picture of any shape.

    A picture with another aspect is assumed to be the largest crop of that camera's, in landscape
    or portrait; docs/accuracy.md has measurements of alternatives.
    """
    aspect = spec.width / spec.height * spec.pixel_aspect
    width, height = frame.display_size_px
    short, long = sorted((width * frame.pixel_aspect, height))
    long_px = max(long, short * max(aspect, 1 / aspect))
    width_px = long_px if aspect >= 1 else long_px * aspect
    focal_px = width_px * scaling.focal_px_of_hfov(camera.hfov_deg, 1)
    return PictureCamera(focal_px / frame.pixel_aspect, CameraSource.CARD)
