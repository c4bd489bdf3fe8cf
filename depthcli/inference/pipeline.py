"""From a picture to its depth map: preprocessing, network, postprocessing."""

import math
import os
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from depthcli.core import scaling
from depthcli.core.camera import Lens
from depthcli.core.choices import AUTO_TILE, DEFAULT_DETAIL, Detail
from depthcli.core.types import DepthMap, Frame, Provenance
from depthcli.errors import InputError, ModelError
from depthcli.inference.camera import PictureCamera, camera_of
from depthcli.inference.loading import SessionLoader
from depthcli.inference.postprocess import coarse_depth, full_size
from depthcli.inference.preprocess import Layout, prepare
from depthcli.inference.providers import AUTO
from depthcli.inference.session import Session
from depthcli.models.card import ModelCard
from depthcli.models.card_specs import InputSpec

_MAX_CELLS_A_PIXEL = 4  # of a tiled map; more show nothing of the picture


class Pipeline:
    """A loaded model with its pre- and postprocessing.

    Attributes:
        session: the loaded model.
        detail: how full-size depth is made from its output.
    """

    def __init__(self, session: Session, detail: Detail = DEFAULT_DETAIL) -> None:
        self.session = session
        self.detail = detail

    @property
    def card(self) -> ModelCard:
        """The model's card."""
        return self.session.model.card

    def predict(
        self, frame: Frame, *, focal_px: float | None = None, hfov_deg: float | None = None
    ) -> DepthMap:
        """Depth of every pixel of a picture.

        A model that was trained on one camera is right only for that camera. If the picture's own
        is known, metres are scaled by the ratio of focal lengths. If the model states no
        camera, or gives no metres, the focal length is only stated in the map's provenance.

        Args:
            frame: the picture.
            focal_px: focal length in pixels of the picture.
            hfov_deg: horizontal field of view in degrees, in place of ``focal_px``. With neither,
                the 35-mm focal length in the picture's EXIF is used, if it is there; else the
                model's own camera is assumed. The map's provenance says which.

        Returns:
            (H, W) at the picture's size, of the card's kind.

        Raises:
            InputError: the tiles are too small for the picture.
            ModelError: the network failed.
            UsageError: the focal length is not valid.
        """
        return self.predict_many((frame,), focal_px=focal_px, hfov_deg=hfov_deg)[0]

    def predict_many(
        self,
        frames: Sequence[Frame],
        *,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
        lenses: Sequence[Lens | None] = (),
    ) -> list[DepthMap]:
        """Depth of several pictures; those with the same input size are run as one batch.

        Args:
            frames: the pictures, of any sizes.
            focal_px: as in :meth:`predict`, for each picture.
            hfov_deg: as in :meth:`predict`, for each picture.
            lenses: the own focal length of each picture, instead; None where ``focal_px`` and
                ``hfov_deg`` apply. Empty if they apply to all.

        Returns:
            What :meth:`predict` returns for each, in their order.

        Raises:
            InputError: the tiles are too small for a picture.
            ModelError: the network failed.
            UsageError: the focal length is not valid.
        """
        for frame in frames:
            tile_width_px(self.card.input, frame, self.detail)
        given = Lens(focal_px, hfov_deg)
        own = [lens or given for lens in lenses or [None] * len(frames)]
        for lens in (given, *own):
            scaling.check_camera(lens.focal_px, lens.hfov_deg)
        prepared = [prepare(self.card.input, frame) for frame in frames]
        raws = self._run([single for single, _ in prepared])
        return [
            self._finish(frame, raw, layout, camera_of(self.card, frame, layout, lens))
            for frame, raw, (_, layout), lens in zip(frames, raws, prepared, own, strict=True)
        ]

    def _finish(
        self,
        frame: Frame,
        raw: npt.NDArray[np.float32],
        layout: Layout,
        camera: PictureCamera | None,
    ) -> DepthMap:
        coarse = coarse_depth(self.card.output, raw, layout)
        if not np.isfinite(coarse).any():
            raise ModelError(
                f"{self.session.model.path} gives no depth for {frame.path or 'a picture'}: "
                "not one number is finite; use another model, or export it again"
            )
        tile_px, radius = tile_width_px(self.card.input, frame, self.detail), 1
        if tile_px is not None:
            from depthcli.inference.tiles import refine  # noqa: PLC0415 - few pictures need it

            columns = coarse.shape[1]
            coarse = refine(self.card.output, coarse, frame, tile_px, self._coarse)
            radius = math.ceil(coarse.shape[1] / columns)
        values = full_size(self.card.output, coarse, frame, self.detail.upsampling, radius)
        if camera is not None and camera.scale != 1:
            values *= np.float32(camera.scale)
        source = self._provenance(frame, layout, camera)
        return DepthMap(values, self.card.output.kind, source)

    def _coarse(self, frame: Frame) -> npt.NDArray[np.float32]:
        batch, layout = prepare(self.card.input, frame)
        return coarse_depth(self.card.output, self.session.run(batch)[0], layout)

    def _run(self, inputs: Sequence[npt.NDArray[np.float32]]) -> list[npt.NDArray[np.float32]]:
        """The network's (h, w) output for each (1, C, H, W) input, batched by size."""
        sizes: dict[tuple[int, ...], list[int]] = {}
        for i, single in enumerate(inputs):
            sizes.setdefault(single.shape, []).append(i)
        outputs: dict[int, npt.NDArray[np.float32]] = {}
        for members in sizes.values():
            together = [inputs[i] for i in members]
            batch = together[0] if len(together) == 1 else np.concatenate(together)
            outputs |= zip(members, self.session.run(batch), strict=True)
        return [outputs[i] for i in range(len(inputs))]

    def _provenance(self, frame: Frame, layout: Layout, camera: PictureCamera | None) -> Provenance:
        return Provenance(
            model=self.card.name,
            model_sha256=self.session.model.sha256,
            input_size_px=(layout.width, layout.height),
            focal_px=camera.focal_px if camera else None,
            orientation=frame.orientation,
            camera_source=camera.source if camera else None,
            time_s=frame.timestamp_s,
            pixel_aspect=frame.pixel_aspect,
        )


def tile_width_px(spec: InputSpec, frame: Frame, detail: Detail) -> int | None:
    """Width of the tiles of a picture in its pixels; None if it is not tiled.

    Raises:
        InputError: tiles of this width have less detail than the network's input.
    """
    if detail.tile_px is None:
        return None
    width, chosen = frame.width, detail.tile_px
    if chosen == AUTO_TILE:
        chosen = max(-(-3 * width // 4), spec.width)
    finest_px = math.ceil(
        math.sqrt(spec.width * spec.height * width / (_MAX_CELLS_A_PIXEL * frame.height))
    )
    if chosen < min(finest_px, width):
        raise InputError(
            f"tiles of {chosen} pixels have less detail than the network's input, and those of "
            f"{finest_px} have not",
            "give a wider {tile}, or leave it out",
        )
    return chosen if chosen < width else None


def load(
    model: str | os.PathLike[str] | None = None,
    *,
    provider: str = AUTO,
    threads: int | None = None,
    detail: Detail = DEFAULT_DETAIL,
    provider_options: Mapping[str, str] | None = None,
) -> Pipeline:
    """The layer below ``load_model``, with the same arguments and errors.

    Warnings are in the session's ``warnings``. The model may be None for the default one.
    """
    loader = SessionLoader(model, provider, threads, provider_options or {})
    return Pipeline(loader.load(), detail)
