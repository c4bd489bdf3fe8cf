"""From an image to its finished depth map; trial runs that tell a broken model from an image."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from depthcli.core import options, types
from depthcli.core.camera import (
    DEPTH_M_RANGE,
    UNKNOWN_CAMERA,
    WIDEST_DEG,
    CameraScale,
    CameraSource,
    Intrinsics,
    hfov_deg,
)
from depthcli.core.options import DEFAULT_UPSAMPLING, DepthMask, UpsamplingOptions
from depthcli.errors import InputError, Message, ModelError, UsageError
from depthcli.inference import transforms
from depthcli.inference.session import RawOutputs, Session
from depthcli.known.points import KnownDepth, fitted
from depthcli.models.card import InputSpec, OutputSpec

_LONGEST = 2.5  # of images of one shot; phones' panoramas are longer
_STEP = 4  # pixels between those that are counted
_END_SHARE, _MANY = 0.02, 0.1  # of the depth at an end of the range; of the pixels
_MAX_CELLS_A_PIXEL = 4  # of a tiled map; more show nothing of the image

NETWORK_FROM = 2
"""Number of known points from which a network takes them; of one, a fit is as good."""


class Prediction(NamedTuple):
    """The depth of an image."""

    #: of every pixel of its frame, also of those outside the display window of an EXR
    depth: types.DepthMap
    warnings: tuple[str, ...]  #: about the map and its fit to known points, one line each


class Pipeline:
    """A loaded model with its pre- and postprocessing."""

    def __init__(self, session: Session, detail: UpsamplingOptions = DEFAULT_UPSAMPLING) -> None:
        self.session = session
        self.card = session.model.card
        self.detail = detail

    def predict(
        self,
        frame: types.Frame,
        camera: Intrinsics = UNKNOWN_CAMERA,
        anchors: KnownDepth | None = None,
    ) -> Prediction:
        """Depth of every pixel of an image.

        A model that was trained on one camera is right only for that camera. If the image's own
        is known, metres are scaled by the ratio of focal lengths. If the model states no
        camera, or gives no metres, the focal length is only stated in the map's provenance.

        Args:
            frame: the image.
            camera: what is known of its camera. Without a focal length, the 35-mm focal length in
                the image's EXIF is used, if it is there; else the model's own camera is assumed.
                The map's provenance says which.
            anchors: known depth that the metres are fitted to; None to keep those of the model.

        Raises:
            InputError: the tiles are too small for the image, or the camera or the known depth
                does not fit it.
            ModelError: the network failed.
        """
        return self._predict_batch([frame], [camera], [anchors])[0]

    def predict_many(
        self,
        frames: Sequence[types.Frame],
        cameras: Sequence[Intrinsics],
        anchors: Sequence[KnownDepth | None],
    ) -> list[Prediction | Exception]:
        """Depth of several images; those with the same input size are run as one batch.

        It is what :meth:`predict` returns for each, or the error that it raises.
        """
        try:
            return [*self._predict_batch(frames, cameras, anchors)]
        except Exception as error:  # noqa: BLE001 - no image may stop the others
            if len(frames) == 1:
                return [error]
        tasks = zip(frames, cameras, anchors, strict=True)
        return [self.predict_many([f], [c], [a])[0] for f, c, a in tasks]

    def _predict_batch(
        self,
        frames: Sequence[types.Frame],
        cameras: Sequence[Intrinsics],
        known_depth: Sequence[KnownDepth | None],
    ) -> list[Prediction]:
        known_depth = [
            points and points.beside(frame.display_size_px, frame.orientation)
            for frame, points in zip(frames, known_depth, strict=True)
        ]
        is_panorama = any(frame.projection.is_other for frame in frames)
        if is_panorama or (
            self.session.load_known_depth and any(map(_is_for_network, known_depth))
        ):
            return [self._alone(*task) for task in zip(frames, cameras, known_depth, strict=True)]
        lens = [
            transforms.intrinsics_of(self.card, *pair) for pair in zip(frames, cameras, strict=True)
        ]
        frames = [
            frame
            if camera.pixel_aspect in {None, frame.pixel_aspect}
            else replace(frame, pixel_aspect=camera.pixel_aspect)
            for frame, camera in zip(frames, lens, strict=True)
        ]
        prepared = [transforms.prepare(self.card.input, frame) for frame in frames]
        if self.detail.mask is DepthMask.MODEL and self.card.output.mask is None:
            problem = f"model {self.card.name!r} gives no mask"
            raise InputError(problem, "leave {mask} out, or give another {model}")
        if self.detail.error and self.session.load_error is None:
            problem = f"the error of depth of model {self.card.name!r} is not known"
            raise InputError(problem, "leave {error} out")
        layouts = [layout for _, layout in prepared]
        known_points = [self._for_network(*each) for each in zip(frames, known_depth, strict=True)]
        prompts = [
            None if points is None else transforms.prompt_input(self.card, points, frame, layout)
            for frame, layout, points in zip(frames, layouts, known_points, strict=True)
        ]
        matrices = [self._camera_matrix(*each) for each in zip(frames, layouts, lens, strict=True)]
        raws = self._run([single for single, _ in prepared], prompts, matrices)
        estimates = map(self._model_depth, frames, raws, layouts, lens, known_points)
        parts = zip(estimates, frames, known_depth, strict=True)
        return [_finished(done, f, points, followed) for (done, followed), f, points in parts]

    def _alone(
        self, frame: types.Frame, camera: Intrinsics, known_depth: KnownDepth | None
    ) -> Prediction:
        """Depth of a panorama, or by the network that takes known depth where there is enough."""
        if frame.projection.is_other:
            return _finished(self._panorama(frame, camera), frame, known_depth)
        session = self.session.known_depth if _is_for_network(known_depth) else None
        pipeline = self if session is None else Pipeline(session, self.detail)
        return pipeline.predict(frame, camera, known_depth)

    def _for_network(self, frame: types.Frame, known_depth: KnownDepth | None) -> KnownDepth | None:
        """Known depth for the network; None if it takes none, or there is too little."""
        if known_depth is None or not _is_for_network(known_depth):
            if self.card.input.known_depth is not None:
                raise InputError(
                    f"model {self.card.name!r} needs known depth of each image",
                    f"give {{anchors}} of {NETWORK_FROM} points or more, or another {{model}}",
                )
            return None
        if not self.card.input.prompt_inputs:
            if known_depth.fit is options.DepthFit.NETWORK:
                raise InputError(
                    f"model {self.card.name!r} takes no known depth",
                    "give another {model}, or another {anchors_fit}",
                )
            return None
        try:
            return known_depth.within(*frame.display_size_px)
        except UsageError as error:
            raise InputError(str(error)) from error

    def _model_depth(
        self,
        frame: types.Frame,
        raw: RawOutputs,
        layout: transforms.Layout,
        camera: Intrinsics,
        points: KnownDepth | None,
    ) -> tuple[Prediction, types.BoolArray | None]:
        """Depth at the image's size, as the model and the camera, or known depth, give it.

        Of known depth, also which points it follows: (N,).
        """
        spec = self.card.output
        if points:  # metres are those of the points, whatever the range and the camera
            camera = replace(camera, scale=None)
            spec = replace(spec, min_m=DEPTH_M_RANGE[0], max_m=DEPTH_M_RANGE[1])
        if spec.points:
            raw = _of_points(spec, raw, camera, frame)
        own_deg = None if raw.hfov_deg is None else float(raw.hfov_deg)
        camera = transforms.with_own_view(camera, own_deg, frame.width)
        coarse = unrefined = transforms.coarse_depth(spec, raw.maps, layout)
        if not np.isfinite(coarse).any():
            where = frame.path or "an image"
            problem = f"{self.session.model.path} gives no depth for {where}, no finite number"
            raise ModelError(problem, "use another model, or export it again")
        tile_px, radius = tile_width_px(self.card.input, frame, self.detail), 1
        if tile_px is not None:
            from depthcli.inference.tiles import refine  # noqa: PLC0415 - few images need it

            columns = coarse.shape[1]
            coarse = refine(spec, coarse, frame, tile_px, partial(_coarse, self.session))
            radius = math.ceil(coarse.shape[1] / columns)
        coarse, followed = transforms.follow_points(self.card, coarse, frame, points)
        if coarse is unrefined and self.detail.upsampling is options.Upsampling.MODEL:
            values = transforms.enlarged(spec, raw.maps, layout, frame)
        else:
            values = transforms.full_size(spec, coarse, frame, self.detail.upsampling, radius)
        scale = 1.0 if points else transforms.metric_scale(self.card, frame, layout, camera)
        if scale != 1:
            values *= np.float32(scale)
        if camera.scale is not None:
            values = self._calibrated(values, camera.scale)
        if self.detail.mask is DepthMask.MODEL and spec.mask and raw.mask is not None:
            values[transforms.without_depth(spec.mask, raw.mask, layout, frame)] = np.nan
        source = self._provenance(frame, (layout.width, layout.height), camera)
        depth = types.DepthMap(values, self.card.output.kind, source, self._error(frame))
        warnings = _range_warnings(spec, depth, scale)
        return Prediction(depth, warnings), followed

    def _error(self, frame: types.Frame) -> types.Float32Array | None:
        """The relative error that the depth of an image is expected to have, (H, W) float32."""
        if not self.detail.error or self.session.load_error is None:
            return None
        session = self.session.load_error()
        coarse = _coarse(session, frame)
        bilinear = options.Upsampling.BILINEAR
        return transforms.full_size(session.model.card.output, coarse, frame, bilinear)

    def _calibrated(self, depth_m: types.Float32Array, scale: CameraScale) -> types.Float32Array:
        """Metres corrected as it was measured for a camera; NaN where none are left."""
        if scale.model_sha256 != self.session.model.sha256:
            problem = f"camera {scale.name!r} was calibrated with another model, {scale.model!r}"
            raise UsageError(problem, "calibrate it with this one")
        corrected_m = depth_m * np.float32(scale.scale) + np.float32(scale.shift_m)
        return np.where(corrected_m > 0, corrected_m, np.float32(np.nan))

    def _panorama(self, frame: types.Frame, camera: Intrinsics) -> Prediction:
        from depthcli.inference.tiles import HFOV_DEG, panorama_distance  # noqa: PLC0415 - rare

        if camera.has_focal or camera.centre_px:
            problem = "an equirectangular image has no focal length and no principal point"
            raise InputError(problem, "leave them out, or give {projection} pinhole")
        if transforms.metric_camera(self.card) is None:
            problem = f"model {self.card.name!r} gives no metres of a known camera for a panorama"
            raise InputError(problem, "give another {model}")
        if self.detail.error:
            raise InputError("the error of depth of a panorama is not known", "leave {error} out")
        view, sources = Intrinsics(hfov_deg=HFOV_DEG), list[types.Provenance]()

        def predict(view_frame: types.Frame) -> types.Float32Array:
            depth = self._predict_batch([view_frame], [view], [None])[0].depth
            sources.append(depth.provenance)
            return depth.values

        values = panorama_distance(frame, predict)
        source = self._provenance(frame, sources[0].input_size_px, UNKNOWN_CAMERA)
        return Prediction(types.DepthMap(values, self.card.output.kind, source), ())

    def _camera_matrix(
        self, frame: types.Frame, layout: transforms.Layout, camera: Intrinsics
    ) -> types.Float32Array | None:
        """The camera in pixels of the network's input, (3, 3); None if the network takes none."""
        if self.card.input.camera_matrix is None:
            return None
        if camera.focal_px is None or self.detail.tile_px is not None:
            problem = f"model {self.card.name!r} needs the focal length, and the whole image"
            raise InputError(problem, "give {focal_px} or {hfov}, and no {tile}")
        across, down = layout.inner_width / frame.width, layout.inner_height / frame.height
        x, y = camera.centre_px or ((frame.width - 1) / 2, (frame.height - 1) / 2)
        x, y = layout.left + (x + 0.5) * across - 0.5, layout.top + (y + 0.5) * down - 0.5
        focal_px, aspect = camera.focal_px, frame.pixel_aspect
        rows = (focal_px * across, 0, x), (0, focal_px * aspect * down, y), (0, 0, 1)
        return np.array(rows, np.float32)

    def _run(
        self,
        inputs: Sequence[types.Float32Array],
        known_depth: Sequence[types.Float32Array | None],
        matrices: Sequence[types.Float32Array | None],
    ) -> list[RawOutputs]:
        """The network's output for each (1, C, H, W) input, batched by size.

        ``known_depth`` is (C, H, W) for each, ``matrices`` (3, 3); None for none.
        """
        batches: dict[tuple[int, ...], list[int]] = {}
        for i, single in enumerate(inputs):
            batches.setdefault((i,) if self.session.takes_one else single.shape, []).append(i)
        outputs: dict[int, RawOutputs] = {}
        for members in batches.values():
            together = [inputs[i] for i in members]
            batch = together[0] if len(together) == 1 else np.concatenate(together)
            knowns, cameras = [known_depth[i] for i in members], [matrices[i] for i in members]
            raw = self.session.outputs(batch, knowns, cameras)
            outputs |= {member: raw.image(i) for i, member in enumerate(members)}
        return [outputs[i] for i in range(len(inputs))]

    def _provenance(
        self, frame: types.Frame, input_size_px: tuple[int, int] | None, camera: Intrinsics
    ) -> types.Provenance:
        return types.Provenance(
            model=self.card.name,
            model_sha256=self.session.model.sha256,
            input_size_px=input_size_px,
            focal_px=camera.focal_px,
            orientation=frame.orientation,
            camera_source=camera.source,
            centre_px=camera.centre_px,
            time_s=frame.timestamp_s,
            pixel_aspect=frame.pixel_aspect,
            projection=frame.projection,
            camera_scale=camera.scale,
        )


def _coarse(session: Session, frame: types.Frame) -> types.Float32Array:
    """Depth of an image at the network's size, (h, w), without a camera or known depth."""
    batch, layout = transforms.prepare(session.model.card.input, frame)
    return transforms.coarse_depth(session.model.card.output, session.run(batch)[0], layout)


def _is_for_network(known_depth: KnownDepth | None) -> bool:
    """Whether a network that takes known depth is to make depth of it."""
    if known_depth and known_depth.fit is None:
        return len(known_depth) >= NETWORK_FROM
    return bool(known_depth and known_depth.fit is options.DepthFit.NETWORK)


def _of_points(
    spec: OutputSpec, raw: RawOutputs, camera: Intrinsics, frame: types.Frame
) -> RawOutputs:
    """Outputs with depth and a field of view in place of points."""
    from depthcli.inference.point_map import depth_of_points  # noqa: PLC0415 - few models need it

    has_depth = None
    if spec.mask is not None and raw.mask is not None:
        has_depth = ~transforms.lacks_depth(spec.mask, raw.mask)
    focal_px = None if camera.source is CameraSource.CARD else camera.focal_px
    view_deg = None if focal_px is None else hfov_deg(focal_px, frame.width)
    depth, fitted_deg = depth_of_points(raw.maps, has_depth, view_deg)
    scale = 1 if raw.scale is None else raw.scale
    hfov = np.asarray(fitted_deg, np.float32)
    return raw._replace(maps=np.asarray(depth * scale, np.float32), hfov_deg=hfov)


def _range_warnings(spec: OutputSpec, depth: types.DepthMap, scale: float) -> tuple[str, ...]:
    """Warnings of many pixels at the least or the largest depth that the model can give."""
    if spec.min_m is None or spec.max_m is None or not depth.is_metric:
        return ()
    low_m, high_m = spec.min_m * scale, spec.max_m * scale
    values = depth.values[::_STEP, ::_STEP]
    warnings = []
    for at_end, end_m, word in (
        (values <= low_m * (1 + _END_SHARE), low_m, "nearer"),
        (values >= high_m * (1 - _END_SHARE), high_m, "farther"),
    ):
        share = np.count_nonzero(at_end) / values.size
        if share >= _MANY:
            warnings.append(
                f"{share:.0%} of the pixels are at {end_m:.3g} m, an end of the range of the "
                f"model, {low_m:.3g} to {high_m:.3g} m: they may be {word}"
            )
    return tuple(warnings)


def _finished(
    prediction: Prediction,
    frame: types.Frame,
    known_depth: KnownDepth | None,
    followed: types.BoolArray | None = None,
) -> Prediction:
    """Depth without any where the file has no pixels, fitted to known points."""
    depth, warnings = prediction
    depth = types.masked_to_data_window(depth, frame.windows)
    if frame.transparent is not None:
        depth = replace(depth, values=np.where(frame.transparent, np.float32(np.nan), depth.values))
    result, of_fit = fitted(depth, known_depth, frame.windows, followed=followed)
    of_camera = () if known_depth else _camera_warnings(depth, frame)
    return Prediction(result, (*warnings, *of_camera, *of_fit))


def _camera_warnings(depth: types.DepthMap, frame: types.Frame) -> tuple[str, ...]:
    """A warning of a focal length that is hardly the image's, or not in its EXIF; else none."""
    source, focal_px = depth.provenance.camera_source, depth.provenance.focal_px
    width, height = frame.display_size_px
    view_deg = hfov_deg(focal_px or math.inf, width)
    if source is CameraSource.OPTION and view_deg > WIDEST_DEG:
        text = f"a focal length of {focal_px:.4g} pixels sees {view_deg:.0f}°, more than cameras do"
        return (Message(text, "if it is in millimetres, give {focal_35mm} or {hfov}"),)
    if source is CameraSource.CARD and frame.focal_mm is not None:
        text = f"the file states a focal length of {frame.focal_mm:g} mm, and not the sensor's size"
    elif source is CameraSource.EXIF and max(width, height) > _LONGEST * min(width, height):
        text = f"EXIF has the focal length of the lens, not of a panorama of {width}×{height}"
    else:
        return ()
    return (Message(text, "give {focal_px} or {hfov}, as metres may be far off"),)


def tile_width_px(spec: InputSpec, frame: types.Frame, detail: UpsamplingOptions) -> int | None:
    """Width of the tiles of an image in its pixels; None if it is not tiled."""
    if detail.tile_px is None:
        return None
    if spec.known_depth is not None:
        problem = "a network that needs known depth of the whole image takes no tiles"
        raise InputError(problem, "leave {tile} out, or give another {model}")
    width, chosen = frame.width, detail.tile_px
    if chosen == options.AUTO_TILE:
        chosen = max(-(-3 * width // 4), spec.width)
    finest_px = math.ceil(
        math.sqrt(spec.width * spec.height * width / (_MAX_CELLS_A_PIXEL * frame.height))
    )
    if chosen < min(finest_px, width):
        problem = f"tiles of {chosen} pixels have less detail than the network's input"
        raise InputError(problem, f"give a {{tile}} of {finest_px} or more, or leave it out")
    return chosen if chosen < width else None


_GRAY, _HFOV_DEG = 128, 60.0  # of a trial


def try_session(session: Session, width: int | None = None) -> None:
    """Run a loaded model on a gray image of its own size, or of another width."""
    spec = session.model.card.input
    gray = np.full((spec.height, width or spec.width, 3), _GRAY, np.uint8)
    depth_for_trial(Pipeline(session), types.Frame(gray))


def try_other_size(session: Session) -> None:
    """Run a model on a wider image, if its card states that its input may have any size.

    Graphs of dynamic axes may still hold constants that suit one size, such as embeddings.
    """
    model = session.model
    spec = model.card.input
    if not spec.dynamic:
        return
    try:
        try_session(session, spec.width * 3 // 2)
    except ModelError as error:
        size = f"{spec.width} x {spec.height}"
        raise ModelError(
            f"{model.path} runs only on inputs of {size}, although its axes are dynamic",
            "set input.dynamic to false and input.fit to stretch in the card",
        ) from error


def check_network(error: Exception, session: Session) -> None:
    """Check the network after it failed on an input; it may work for the next one."""
    if isinstance(error, ModelError):
        try:
            try_session(session)
        except ModelError:
            raise error from None


def depth_for_trial(pipeline: Pipeline, frame: types.Frame) -> types.DepthMap:
    """Depth of an image; a network that needs known depth or a camera gets some."""
    needs_camera = pipeline.card.input.camera_matrix is not None
    camera = Intrinsics(hfov_deg=_HFOV_DEG) if needs_camera else UNKNOWN_CAMERA
    if pipeline.card.input.known_depth is None:
        return pipeline.predict(frame, camera).depth
    columns, rows = frame.display_size_px
    slope = np.linspace((0, 0, 1), (columns - 1, rows - 1, 2), NETWORK_FROM)
    return pipeline.predict(frame, camera, anchors=KnownDepth.of_table(slope)).depth
