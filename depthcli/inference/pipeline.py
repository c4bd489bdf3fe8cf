"""The whole way from a picture to its depth map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from depthcli.core import scaling
from depthcli.core.choices import Upsampling
from depthcli.core.types import DepthKind, DepthMap, Provenance
from depthcli.errors import UsageError
from depthcli.inference.catalog import find_model
from depthcli.inference.postprocess import coarse_depth, full_size
from depthcli.inference.preprocess import prepare
from depthcli.inference.providers import AUTO
from depthcli.inference.session import Session

if TYPE_CHECKING:
    import os

    from depthcli.core.types import Frame
    from depthcli.inference.card import ModelCard


class Pipeline:
    """A model, ready for pictures.

    Attributes:
        session: the loaded model.
        upsampling: how depth gets from the network's size to the picture's.
    """

    def __init__(
        self, session: Session, *, upsampling: Upsampling | str = Upsampling.GUIDED
    ) -> None:
        """Take a loaded model.

        Args:
            session: the model.
            upsampling: ``guided`` by the picture or ``bilinear``.

        Raises:
            UsageError: there is no such upsampling.
        """
        self.session = session
        self.upsampling = _upsampling(upsampling)

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
            ModelError: the network failed.
            UsageError: a focal length is given, and the model's metres belong to no known camera.
        """
        focal = self._focal_px(frame, focal_px, hfov_deg)
        batch, place = prepare(self.card.input, frame)
        raw = self.session.run(batch)[0]
        coarse = coarse_depth(self.card.output, raw, place)
        values = full_size(self.card.output, coarse, frame, self.upsampling)
        if focal is not None and self.card.camera is not None:
            learned = scaling.focal_px(self.card.camera.hfov_deg, frame.width)
            values = values * np.float32(focal / learned)
        return DepthMap(values, self.card.output.kind, self._provenance(batch.shape, focal))

    def _focal_px(
        self, frame: Frame, focal_px: float | None, hfov_deg: float | None
    ) -> float | None:
        """The picture's focal length, if metres are to be rescaled by it."""
        stated = focal_px is not None or hfov_deg is not None
        if self.card.camera is None or self.card.output.kind is not DepthKind.METRIC:
            if stated:
                raise UsageError(
                    f"model {self.card.name!r} gives no metres of a known camera, so a focal "
                    "length does not apply; leave --focal-px and --hfov out"
                )
            return None
        if focal_px is not None:
            return focal_px
        if hfov_deg is not None:
            return scaling.focal_px(hfov_deg, frame.width)
        if frame.focal_35mm is not None:
            return scaling.focal_px_of_35mm(frame.focal_35mm, frame.width, frame.height)
        return None

    def _provenance(self, shape: tuple[int, ...], focal_px: float | None) -> Provenance:
        model = self.session.model
        return Provenance(self.card.name, model.sha256, (shape[3], shape[2]), focal_px)


def load(
    model: str | os.PathLike[str] | None = None,
    *,
    provider: str = AUTO,
    threads: int | None = None,
    upsampling: Upsampling | str = Upsampling.GUIDED,
) -> Pipeline:
    """Find a model and make it ready.

    Args:
        model: a name in the catalog, a folder, or an ``.onnx`` file; None for the default model.
        provider: ``auto``, or a name such as ``cpu`` or ``cuda`` that has to be there.
        threads: threads within one operator; None for onnxruntime's choice.
        upsampling: ``guided`` by the picture or ``bilinear``.

    Raises:
        ModelError: the model is not there or is damaged.
        ProviderError: the named provider is not available.
        UsageError: there is no such upsampling.
    """
    session = Session(find_model(model), provider=provider, threads=threads)
    return Pipeline(session, upsampling=upsampling)


def _upsampling(name: Upsampling | str) -> Upsampling:
    try:
        return Upsampling(name)
    except ValueError:
        raise UsageError(f"upsampling is {' or '.join(Upsampling)}, not {name!r}") from None
