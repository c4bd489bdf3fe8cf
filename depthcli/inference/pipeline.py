"""The whole way from a picture to its depth map."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from depthcli.core import scaling
from depthcli.core.choices import PLAIN
from depthcli.core.types import DepthKind, DepthMap, Provenance
from depthcli.errors import UsageError
from depthcli.inference.catalog import find_model
from depthcli.inference.memory import tile_width_px
from depthcli.inference.postprocess import coarse_depth, full_size
from depthcli.inference.preprocess import prepare
from depthcli.inference.providers import AUTO
from depthcli.inference.session import Session
from depthcli.inference.tiles import refine

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from depthcli.core.choices import Detail
    from depthcli.core.types import Frame
    from depthcli.inference.card import ModelCard
    from depthcli.inference.preprocess import Layout


class Pipeline:
    """A model, ready for pictures.

    Attributes:
        session: the loaded model.
        detail: how its depth becomes that of a full-size picture.
    """

    def __init__(self, session: Session, detail: Detail = PLAIN) -> None:
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

        A model that learned one camera is right only for that camera's field of view. Where the
        picture's own is known, metres are rescaled: depth grows with the focal length.

        Args:
            frame: the picture.
            focal_px: focal length in pixels of the picture.
            hfov_deg: horizontal field of view in degrees, in place of ``focal_px``. With neither,
                the 35-mm focal length in the picture's EXIF is used, if it is there.

        Returns:
            (H, W) at the picture's size, of the card's kind.

        Raises:
            InputError: the picture needs more memory than the detail's limit.
            ModelError: the network failed.
            UsageError: the focal length makes no sense, or the model's metres belong to no known
                camera.
        """
        return self.predict_many((frame,), focal_px=focal_px, hfov_deg=hfov_deg)[0]

    def predict_many(
        self,
        frames: Sequence[Frame],
        *,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
    ) -> list[DepthMap]:
        """Depth of several pictures, those of one network size in one run of the network.

        Args:
            frames: the pictures, of any sizes.
            focal_px: as in :meth:`predict`, for each picture.
            hfov_deg: as in :meth:`predict`, for each picture.

        Returns:
            What :meth:`predict` gives for each, in their order.

        Raises:
            InputError: a picture needs more memory than the detail's limit.
            ModelError: the network failed.
            UsageError: the focal length makes no sense, or the model's metres belong to no known
                camera.
        """
        for frame in frames:
            tile_width_px(self.card.input, frame, self.detail)
        focals = [self._focal_px(frame, focal_px, hfov_deg) for frame in frames]
        prepared = [prepare(self.card.input, frame) for frame in frames]
        raws = self._run([single for single, _ in prepared])
        return [
            self._finish(frame, raw, place, focal)
            for frame, raw, (_, place), focal in zip(frames, raws, prepared, focals, strict=True)
        ]

    def _finish(
        self,
        frame: Frame,
        raw: npt.NDArray[np.float32],
        place: Layout,
        focal_px: float | None,
    ) -> DepthMap:
        coarse = coarse_depth(self.card.output, raw, place)
        tile_px, reach = tile_width_px(self.card.input, frame, self.detail), 1
        if tile_px is not None:
            columns = coarse.shape[1]
            coarse = refine(self.card.output, coarse, frame, tile_px, self._coarse)
            reach = math.ceil(coarse.shape[1] / columns)
        values = full_size(self.card.output, coarse, frame, self.detail.upsampling, reach)
        if focal_px is not None and self.card.camera is not None:
            learned_px = scaling.focal_px(self.card.camera.hfov_deg, frame.width)
            values *= np.float32(focal_px / learned_px)
        source = self._provenance((place.width, place.height), focal_px, frame.orientation)
        return DepthMap(values, self.card.output.kind, source)

    def _coarse(self, frame: Frame) -> npt.NDArray[np.float32]:
        batch, place = prepare(self.card.input, frame)
        return coarse_depth(self.card.output, self.session.run(batch)[0], place)

    def _run(self, inputs: Sequence[npt.NDArray[np.float32]]) -> list[npt.NDArray[np.float32]]:
        """The network's (h, w) output for each (1, C, H, W) input; equal sizes run together."""
        sizes: dict[tuple[int, ...], list[int]] = {}
        for i, single in enumerate(inputs):
            sizes.setdefault(single.shape, []).append(i)
        outputs: dict[int, npt.NDArray[np.float32]] = {}
        for members in sizes.values():
            together = [inputs[i] for i in members]
            batch = together[0] if len(together) == 1 else np.concatenate(together)
            outputs |= zip(members, self.session.run(batch), strict=True)
        return [outputs[i] for i in range(len(inputs))]

    @property
    def _knows_camera(self) -> bool:
        return self.card.camera is not None and self.card.output.kind is DepthKind.METRIC

    def check_focal(self, focal_px: float | None, hfov_deg: float | None) -> None:
        """Refuse a focal length that makes no sense or would change nothing.

        Raises:
            UsageError: it is not above 0, both are given, or the model's metres belong to no known
                camera.
        """
        scaling.check_camera(focal_px, hfov_deg)
        stated = focal_px is not None or hfov_deg is not None
        if stated and not self._knows_camera:
            raise UsageError(
                f"model {self.card.name!r} gives no metres of a known camera, so a focal "
                "length does not apply; leave --focal-px and --hfov out"
            )

    def _focal_px(
        self, frame: Frame, focal_px: float | None, hfov_deg: float | None
    ) -> float | None:
        """The picture's focal length, if metres are to be rescaled by it."""
        self.check_focal(focal_px, hfov_deg)
        if not self._knows_camera:
            return None
        if focal_px is not None:
            return focal_px
        if hfov_deg is not None:
            return scaling.focal_px(hfov_deg, frame.width)
        if frame.focal_35mm is not None:
            return scaling.focal_px_of_35mm(frame.focal_35mm, frame.width, frame.height)
        return None

    def _provenance(
        self, size_px: tuple[int, int], focal_px: float | None, orientation: int
    ) -> Provenance:
        model = self.session.model
        return Provenance(self.card.name, model.sha256, size_px, focal_px, orientation)


def load(
    model: str | os.PathLike[str] | None = None,
    *,
    provider: str = AUTO,
    threads: int | None = None,
    detail: Detail = PLAIN,
    provider_options: Mapping[str, str] | None = None,
) -> Pipeline:
    """Find a model and make it ready.

    Args:
        model: a name in the catalog, a folder, or an ``.onnx`` file; None for the default model.
        provider: ``auto``, or a name such as ``cpu`` or ``cuda`` that has to be there.
        threads: threads within one operator; None for onnxruntime's choice.
        detail: how its depth becomes that of a full-size picture.
        provider_options: for a provider asked for by name, as onnxruntime documents them.

    Raises:
        ModelError: the model is not there or is damaged.
        ProviderError: the named provider is not available.
        UsageError: no provider has that name, or it takes no options and some are given.
    """
    session = Session(
        find_model(model), provider=provider, threads=threads, provider_options=provider_options
    )
    return Pipeline(session, detail)
