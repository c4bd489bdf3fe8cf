"""The Python API: a model that predicts depth maps of pictures.

>>> import depthcli
>>> model = depthcli.load_model("default")
>>> depth = model.predict("docs/room.jpg", hfov_deg=70)
>>> depth.save("room.exr")
"""

from __future__ import annotations

import os
import warnings
from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np

from depthcli.api.depth_map import Anchors, DepthMap
from depthcli.api.parameter_names import parameter_names, with_parameter_names
from depthcli.api.picture_batches import picture_batches
from depthcli.core import scaling, types
from depthcli.core.camera import Lens
from depthcli.core.choices import DEFAULT_DETAIL, Detail
from depthcli.core.overscan import displayed_depth, displayed_frame, masked_to_data_window
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.core.summary import flat_warnings
from depthcli.errors import DepthcliWarning, InputError, ModelError, UsageError
from depthcli.inference.camera import focal_warnings
from depthcli.inference.pipeline import Pipeline, load
from depthcli.inference.providers import AUTO
from depthcli.io.images.decode import check_white_level
from depthcli.io.images.read import frame_of
from depthcli.models.locations import DEFAULT_MODEL

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence

    from depthcli.api.picture_batches import PictureBatch
    from depthcli.io.images.read import Picture
    from depthcli.models.card import ModelCard

_BATCH_RANK = 4
_MAX_COUNT = 1024  # pictures or threads at a time
_SINGLE = (str, bytes, bytearray, memoryview, os.PathLike, types.Frame)


def load_model(
    model: str | os.PathLike[str] = DEFAULT_MODEL,
    *,
    provider: str = AUTO,
    threads: int | None = None,
    detail: Detail = DEFAULT_DETAIL,
    provider_options: Mapping[str, str] | None = None,
) -> DepthModel:
    """Find and load a model.

    Args:
        model: a name in the catalog, a folder, or an ``.onnx`` file.
        provider: ``auto`` for the best that works, or a name such as ``cpu`` or ``cuda``, which is
            then required.
        threads: threads within one run of the network; None for all cores.
        detail: how full-size depth is made from the network's output.
        provider_options: for a provider given by name, as onnxruntime documents them.

    Raises:
        ModelError: the model is missing or damaged.
        ProviderError: the named provider is not available.
        UsageError: no provider has that name, it takes no options and some are given, or a value
            has the wrong type.
    """
    if not isinstance(model, (str, os.PathLike)):
        raise UsageError(f"a model is a name or a path, not {type(model).__name__}")
    if not isinstance(detail, Detail):
        raise UsageError(f"detail is a depthcli.Detail, not {type(detail).__name__}")
    with parameter_names():
        pipeline = load(
            model,
            provider=provider,
            threads=threads,
            detail=detail,
            provider_options=provider_options,
        )
    for text in pipeline.session.warnings:
        warnings.warn(text, DepthcliWarning, stacklevel=2)
    return DepthModel(pipeline)


class DepthModel:
    """A loaded model; thread-safe.

    Attributes:
        pipeline: the layer below, which takes frames.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline

    @property
    def card(self) -> ModelCard:
        """The model's card: its input, output and training."""
        return self.pipeline.card

    @property
    def provider(self) -> str:
        """The active execution provider, such as ``cpu``."""
        return self.pipeline.session.provider

    def __repr__(self) -> str:
        return f"<DepthModel {self.card.name} {self.card.version}, {self.provider}>"

    def predict(
        self,
        picture: Picture,
        *,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
        anchors: Anchors | None = None,
        white_level: int | None = None,
    ) -> DepthMap:
        """Depth of every pixel of a picture.

        Args:
            picture: a path; the bytes of a file; an array (H, W) gray or (H, W, 3) RGB of uint8,
                uint16 or float32 in [0, 1], whose alpha is dropped; a PIL picture; a ``Frame``.
            focal_px: focal length in pixels of the picture.
            hfov_deg: horizontal field of view in degrees, in place of ``focal_px``. With neither,
                the 35-mm focal length in the picture's EXIF is used, if it has one, else the camera
                that the model learned is assumed; ``camera_source`` of the map states which.
            anchors: known points that metres are fitted to; see :meth:`DepthMap.fit_anchors`. None
                for no fit.
            white_level: value of white in a 16-bit picture, such as 4095 for data of 12 bits; None
                for 65535. Not for a ``Frame``, whose white is 65535.

        Returns:
            (H, W) of the upright picture; of an EXR, of its display window.

        Raises:
            InputError: the picture cannot be read, or is not a picture.
            ModelError: the network failed.
            UsageError: the camera, the anchors or the white level are not valid for this picture.
        """
        scaling.check_camera(focal_px, hfov_deg)
        with parameter_names():
            frame = frame_of(picture, white_level)
            depth = self.pipeline.predict(frame, focal_px=focal_px, hfov_deg=hfov_deg)
        found = _finished(depth, frame, anchors)
        focal = self._focal_warnings(Lens(focal_px, hfov_deg), anchors)
        for text in (*focal, *_picture_warnings(found)):
            warnings.warn(text, DepthcliWarning, stacklevel=2)
        return found

    def predict_many(
        self,
        pictures: Iterable[Picture],
        *,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
        anchors: Anchors | None = None,
        white_level: int | None = None,
        batch_size: int = 1,
        workers: int = 0,
    ) -> Iterator[DepthMap]:
        """Depth of a stream of pictures of one camera, in their order and in constant memory.

        Args:
            pictures: as in :meth:`predict`; any number, read when they are needed.
            focal_px: as in :meth:`predict`.
            hfov_deg: as in :meth:`predict`.
            anchors: as in :meth:`predict`.
            white_level: as in :meth:`predict`.
            batch_size: pictures in one run of the network, which is faster on a GPU.
            workers: threads; 0 works in the calling thread and never reads ahead. With more, twice
                as many batches are read ahead: use 0 for a live camera, all cores for a folder.

        Returns:
            An iterator of one map a picture. An error of :meth:`predict`, or of the iterator of
            pictures, is raised at its position, after the maps before it, and ends the iterator.

        Raises:
            UsageError: the camera or the white level is not valid, or ``pictures`` is a single
                picture.
        """
        scaling.check_camera(focal_px, hfov_deg)
        check_white_level(white_level)
        _check_several(pictures, batch_size, workers)
        for text in self._focal_warnings(Lens(focal_px, hfov_deg), anchors):
            warnings.warn(text, DepthcliWarning, stacklevel=2)

        def predicted(batch: PictureBatch) -> tuple[list[DepthMap], Exception | None]:
            frames, error = batch.frames(white_level)
            maps: list[DepthMap] = []
            try:
                depths = self._depths(frames, focal_px, hfov_deg)
                for depth, frame in zip(depths, frames, strict=True):
                    maps.append(_finished(depth, frame, anchors))
            except Exception as problem:  # noqa: BLE001 - raised at its position
                return maps, problem
            return maps, error

        batches = picture_batches(pictures, batch_size, white_level)
        return _maps(ordered_map(predicted, batches, workers=workers))

    def _focal_warnings(self, lens: Lens, anchors: Anchors | None) -> tuple[str, ...]:
        return focal_warnings(self.card, lens) if anchors is None else ()

    def _depths(
        self, frames: Sequence[types.Frame], focal_px: float | None, hfov_deg: float | None
    ) -> Iterator[types.DepthMap]:
        """Depth of a batch; one by one if it fails, for the maps before the bad picture."""
        try:
            yield from self.pipeline.predict_many(frames, focal_px=focal_px, hfov_deg=hfov_deg)
        except (InputError, ModelError, MemoryError):
            for frame in frames:
                yield self.pipeline.predict(frame, focal_px=focal_px, hfov_deg=hfov_deg)


def _maps(
    batches: Generator[tuple[list[DepthMap], Exception | None], None, None],
) -> Iterator[DepthMap]:
    """The maps of batches, then the error that ended one."""
    with closing(batches):
        for maps, error in batches:
            for depth in maps:
                for text in _picture_warnings(depth):
                    warnings.warn(text, DepthcliWarning, stacklevel=2)
                yield depth
            if error is not None:
                with parameter_names():
                    raise error


def _finished(depth: types.DepthMap, frame: types.Frame, anchors: Anchors | None) -> DepthMap:
    windows = frame.windows
    shown = displayed_depth(masked_to_data_window(depth, windows), windows)
    found = DepthMap.of(shown, displayed_frame(frame))
    return found if anchors is None else found.fit_anchors(anchors)


def _picture_warnings(depth: DepthMap) -> Iterator[str]:
    """What is wrong with a map or its picture, such as data of 12 bits in 16."""
    if depth.frame is not None:
        for text in (*depth.frame.warnings, *flat_warnings(depth)):
            yield f"{depth.frame.path or 'a picture'}: {with_parameter_names(text)}"


def _check_several(pictures: object, batch_size: int, workers: int) -> None:
    for name, number, least in (("batch_size", batch_size, 1), ("workers", workers, 0)):
        if not isinstance(number, (int, np.integer)) or not least <= number <= _MAX_COUNT:
            raise UsageError(
                f"{name} is a whole number from {least} to {_MAX_COUNT}, not {number!r}"
            )
    is_single = getattr(pictures, "ndim", _BATCH_RANK) < _BATCH_RANK  # of arrays and tensors
    if is_single or isinstance(pictures, _SINGLE) or not hasattr(pictures, "__iter__"):
        raise UsageError(
            "predict_many takes several pictures, as a list, an iterator or an array of four axes; "
            "use predict for one"
        )
