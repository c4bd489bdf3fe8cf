"""Measuring the scale of a model's metres for a camera, from known depth in a few images."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from depthcli.core.camera import UNKNOWN_CAMERA, Anchor, CameraScale, Intrinsics, hfov_deg
from depthcli.core.types import DepthKind, DepthMap, Float64Array, Frame
from depthcli.errors import InputError, UsageError, about
from depthcli.inference.pipeline import Pipeline
from depthcli.io.images.read import read_image, undistorted
from depthcli.io.listing import list_folder
from depthcli.io.storage.paths import path_of
from depthcli.known import files, sources
from depthcli.known.points import KnownDepth, Pairs, ScaleShift, robust

_MOST_POINTS = 2000  # of an image, evenly spaced
_SHIFT_POINTS = 10  # from which a shift is tried
_GAIN = 0.98  # a shift has to lower the error of points that were left out to this share


class KnownObject(NamedTuple):
    """An object of known height that faces the camera."""

    x0: float  #: left side of its box in the image, px
    y0: float  #: top, px
    x1: float  #: right side, px
    y1: float  #: bottom, px
    height_m: float  #: metres


@dataclass(frozen=True, slots=True)
class CalibrationRequest:
    """Images with known depth, and the name of their camera."""

    name: str  #: of the camera
    pipeline: Pipeline  #: the model whose metres are corrected
    images: tuple[str, ...] = ()  #: image files of the camera
    pairs: Path | None = None  #: or a folder with images in ``rgb/`` and their depth in ``depth/``
    #: known depth of the images: points of a single one, a file, or a folder with one for each
    anchors: files.KnownDepthFiles | tuple[Anchor, ...] = ()
    known_object: KnownObject | None = None  #: or an object of known height in a single image
    camera: Intrinsics = UNKNOWN_CAMERA  #: what else is known of the camera


class Calibrated(NamedTuple):
    """The scale of a camera, and what it is worth."""

    scale: CameraScale
    #: of all images, if they share one: field of view; principal point and aspect as given
    camera: Intrinsics
    before: float  #: mean of |error| ÷ depth without the scale, on the same points
    warnings: tuple[str, ...]


class _Sample(NamedTuple):
    predicted_m: Float64Array
    true_m: Float64Array


def calibrate(request: CalibrationRequest) -> Calibrated:
    """Measure the scale of a camera, and its shift if that helps on points that are left out.

    The scale is the median over images of the median of true ÷ predicted depth. A shift is
    used if, fitted to one half of the images (of the points of a single one) and tried on the
    other, both ways, it lowers the mean of |error| ÷ depth by 2 % or more.
    """
    if request.pipeline.card.output.kind is not DepthKind.METRIC:
        raise UsageError(f"model {request.pipeline.card.name!r} gives no metres to correct")
    samples, cameras = [], dict[tuple[float, ...], Intrinsics]()
    warnings = [*request.camera.warnings]
    for frame, truth in _known(request):
        depth = request.pipeline.predict(frame, replace(request.camera, scale=None)).depth
        name = str(frame.path or request.pairs)
        try:
            points = truth.beside(frame.display_size_px, frame.orientation)
            points = points.within(depth.width, depth.height) if len(truth) else truth
        except UsageError as error:
            raise InputError(error.message.about(name)) from error
        warnings += [about(name, warning) for warning in points.warnings]
        sample = _sample(depth, points)
        if len(sample.true_m):
            samples.append(sample)
        camera = _camera(depth, frame, request.camera)
        cameras.setdefault(_rounded(camera), camera)
    if not samples:
        raise UsageError("no known depth lies where the model gives any", "give more of it")
    halves, count = _halves(samples), sum(len(sample.true_m) for sample in samples)
    scales = _left_out(halves, _scale) if count > 1 else None
    shifts = _left_out(halves, _scale_shift) if count >= _SHIFT_POINTS else math.inf
    is_shifted = scales is not None and shifts < _GAIN * scales
    fit = (_scale_shift if is_shifted else _scale)(samples)
    session = request.pipeline.session
    scale = CameraScale(
        request.name,
        model=session.model.card.name,
        model_sha256=session.model.sha256,
        scale=fit.scale,
        shift_m=fit.shift,
        residual=shifts if is_shifted else scales,
        images=len(samples),
        points=count,
    )
    before = _error(ScaleShift(1.0, 0.0), samples)
    if scale.residual is not None and scale.residual >= before:
        warnings.append("the scale does not lower the error of points that were left out")
    if len(cameras) > 1:
        warnings.append("the images have several fields of view or sizes, so none is kept")
    shared_camera = UNKNOWN_CAMERA if len(cameras) > 1 else next(iter(cameras.values()))
    return Calibrated(scale, shared_camera, before, tuple(warnings))


def _camera(depth: DepthMap, frame: Frame, camera: Intrinsics) -> Intrinsics:
    """The camera as one of its images shows it, in a form that fits images of any size."""
    size_px, source = frame.display_size_px, depth.provenance
    return Intrinsics(
        hfov_deg=source.focal_px and hfov_deg(source.focal_px, size_px[0]),
        centre_px=source.centre_px,
        size_px=size_px if source.centre_px else None,
        pixel_aspect=camera.pixel_aspect,
        distortion=camera.distortion if camera.is_undistorted else None,
        is_undistorted=camera.is_undistorted,
    )


def _rounded(camera: Intrinsics) -> tuple[float, ...]:
    """Field of view and principal point up to what images differ in that were resized."""
    sides = zip(camera.centre_px or (), camera.size_px or (), strict=True)
    return round(camera.hfov_deg or 0, 2), *(round((at + 0.5) / side, 3) for at, side in sides)


def _known(request: CalibrationRequest) -> Iterator[tuple[Frame, KnownDepth]]:
    if request.pairs is not None:
        if request.camera.is_undistorted:
            problem = "its depth is of images with their distortion"
            raise UsageError(problem, "leave {undistort} out", option="pairs")
        yield from _of_pairs(request.pairs)
        return
    for name in request.images:
        frame = undistorted(read_image(path_of(name)), request.camera)
        yield frame, _points(request, frame)


def _of_pairs(folder: Path) -> Iterator[tuple[Frame, KnownDepth]]:
    """Images below ``rgb/``, and known depth of the same names below ``depth/``."""
    depth = files.KnownDepthFiles(str(folder / "depth"))
    for image in list_folder(str(folder / "rgb")).media:
        frame = read_image(image.readable_path())
        points = sources.read_file(depth.file_for(image.name), depth)
        yield frame, replace(points, warnings=())  # of assumed millimetres, which the help states


def _points(request: CalibrationRequest, frame: Frame) -> KnownDepth:
    anchors = request.anchors
    if request.known_object is not None:
        focal_px = request.camera.focal_for(frame.width, frame.height)
        if focal_px is None:
            raise UsageError("", "an object of known height needs {focal_px} or {hfov}")
        x0, y0, x1, y1, height_m = request.known_object
        focal_px *= request.camera.pixel_aspect or frame.pixel_aspect  # in rows
        depth_m = focal_px * height_m / (y1 - y0)
        return KnownDepth.of([Anchor(round((x0 + x1) / 2), round((y0 + y1) / 2), depth_m)])
    image = Path(frame.path or "")
    if not (isinstance(anchors, tuple) or anchors.is_by_image) and path_of(anchors.path).is_dir():
        return sources.read_file(anchors.file_for(image.name, image=image), anchors)
    return sources.read_known_depth(anchors, image)


def _sample(depth: DepthMap, points: KnownDepth) -> _Sample:
    """Predicted and true depth at the points, evenly thinned."""
    chosen = np.linspace(0, len(points) - 1, min(len(points), _MOST_POINTS)).astype(np.int64)
    predicted_m = depth.values[points.y[chosen], points.x[chosen]].astype(np.float64)
    is_known = np.isfinite(predicted_m) & (predicted_m > 0)
    return _Sample(predicted_m[is_known], points.depth_m[chosen][is_known])


def _halves(samples: Sequence[_Sample]) -> tuple[Sequence[_Sample], Sequence[_Sample]]:
    """Every second image; of a single image, every second point."""
    if len(samples) > 1:
        return samples[::2], samples[1::2]
    predicted_m, true_m = samples[0]
    return [_Sample(predicted_m[::2], true_m[::2])], [_Sample(predicted_m[1::2], true_m[1::2])]


def _scale(samples: Sequence[_Sample]) -> ScaleShift:
    """Median over images of the median of log(true ÷ predicted)."""
    logs = [np.median(np.log(true_m / predicted_m)) for predicted_m, true_m in samples]
    return ScaleShift(float(np.exp(np.median(logs))), 0.0)


def _scale_shift(samples: Sequence[_Sample]) -> ScaleShift:
    predicted_m = np.concatenate([sample.predicted_m for sample in samples])
    true_m = np.concatenate([sample.true_m for sample in samples])
    fit, _ = robust(Pairs(predicted_m, true_m, true_m))
    return fit if fit.scale > 0 else _scale(samples)


def _left_out(
    halves: tuple[Sequence[_Sample], Sequence[_Sample]],
    fit: Callable[[Sequence[_Sample]], ScaleShift],
) -> float:
    """Mean error of each half with the fit to the other."""
    first, second = halves
    return (_error(fit(first), second) + _error(fit(second), first)) / 2


def _error(fit: ScaleShift, samples: Sequence[_Sample]) -> float:
    """Mean over images of the mean of |error| ÷ depth."""
    errors = [
        float(np.mean(np.abs(fit.scale * predicted_m + fit.shift - true_m) / true_m))
        for predicted_m, true_m in samples
    ]
    return sum(errors) / len(errors)
