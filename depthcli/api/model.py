"""The Python API: a model that predicts depth maps of pictures.

>>> import depthcli
>>> model = depthcli.load_model("default")
>>> depth = model.predict("docs/room.jpg", hfov_deg=70)
>>> depth.save("room.exr")
"""

from __future__ import annotations

import itertools
import os
import warnings
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from depthcli.api.depth_map import Anchors, DepthMap, anchor_points
from depthcli.core import types
from depthcli.core.camera import Intrinsics
from depthcli.core.options import DEFAULT_DETAIL, Detail
from depthcli.core.parallel import ordered_map
from depthcli.core.types import Frame, displayed_depth, displayed_frame
from depthcli.errors import DepthcliWarning, UsageError
from depthcli.inference.camera import focal_warnings
from depthcli.inference.pipeline import Pipeline, Prediction, load
from depthcli.inference.providers import AUTO
from depthcli.io.images.pixels import check_white_level
from depthcli.io.images.read import frame_of
from depthcli.models.catalog import DEFAULT_MODEL

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator, Mapping

    from depthcli.core.anchors import AnchorPoints
    from depthcli.io.images.read import Picture
    from depthcli.models.card import ModelCard


class PictureBatch(NamedTuple):
    """Pictures that are processed together."""

    pictures: list[Picture]
    error: Exception | None  #: what ended the caller's iterator after them, if anything did

    def frames(self, white_level: int | None) -> tuple[list[Frame], Exception | None]:
        """The pictures before the first one that cannot be used, and the error after them."""
        found: list[Frame] = []
        try:
            for picture in self.pictures:
                level = None if isinstance(picture, Frame) else white_level
                found.append(frame_of(picture, level))
        except Exception as error:  # noqa: BLE001 - raised at its position
            return found, error
        return found, self.error


def picture_batches(
    pictures: Iterable[Picture], size: int, white_level: int | None
) -> Iterator[PictureBatch]:
    """Up to ``size`` pictures at a time.

    Pixels in memory are copied here, since the caller may overwrite a buffer, or close a PIL
    picture, before the batch is processed; files are not read.
    """
    rest, error = iter(pictures), None
    while error is None:
        some: list[Picture] = []
        try:
            for picture in itertools.islice(rest, size):
                some.append(_own(picture, white_level))  # noqa: PERF401 - kept at an error
        except Exception as problem:  # noqa: BLE001 - raised at its position
            error = problem
        if not some and error is None:
            return
        yield PictureBatch(some, error)


def _own(picture: Picture, white_level: int | None) -> Picture:
    if isinstance(picture, (bytearray, memoryview)):
        return bytes(picture)
    if isinstance(picture, (str, bytes, os.PathLike)):
        return picture
    frame = frame_of(picture, white_level)
    return replace(frame, pixels=frame.pixels.copy()) if frame is picture else frame


_BATCH_RANK = 4
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
        UsageError: no provider has that name, or it takes no options and some are given.
    """
    pipeline = load(
        model, provider=provider, threads=threads, detail=detail, provider_options=provider_options
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
            InputError: the picture cannot be read, or is not a picture, or the anchors do not fit
                it.
            ModelError: the network failed.
            UsageError: the camera, the anchors or the white level are not valid.
        """
        camera = Intrinsics.given(focal_px, hfov_deg)
        points = None if anchors is None else anchor_points(anchors)
        frame = frame_of(picture, white_level)
        found = _finished(self.pipeline.predict(frame, camera, points), frame)
        for text in (*self._focal_warnings(camera, points), *found.warnings):
            warnings.warn(text, DepthcliWarning, stacklevel=2)
        return found.depth

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
        camera = Intrinsics.given(focal_px, hfov_deg)
        points = None if anchors is None else anchor_points(anchors)
        check_white_level(white_level)
        _check_several(pictures, batch_size, workers)
        for text in self._focal_warnings(camera, points):
            warnings.warn(text, DepthcliWarning, stacklevel=2)

        def predicted(batch: PictureBatch) -> list[_Finished | Exception]:
            frames, error = batch.frames(white_level)
            cameras, known = [camera] * len(frames), [points] * len(frames)
            predictions = self.pipeline.predict_many(frames, cameras, known)
            found: list[_Finished | Exception] = [
                one if isinstance(one, Exception) else _finished(one, frame)
                for one, frame in zip(predictions, frames, strict=True)
            ]
            return found if error is None else [*found, error]

        batches = picture_batches(pictures, batch_size, white_level)
        return _maps(ordered_map(predicted, batches, workers=workers))

    def _focal_warnings(self, camera: Intrinsics, points: AnchorPoints | None) -> tuple[str, ...]:
        return focal_warnings(self.card, camera) if points is None else ()


class _Finished(NamedTuple):
    depth: DepthMap
    warnings: tuple[str, ...]  # about the picture and its map, which they name


def _finished(prediction: Prediction, frame: types.Frame) -> _Finished:
    """The map in the display window, with its picture."""
    shown = displayed_depth(prediction.depth, frame.windows)
    name = frame.path or "a picture"
    texts = tuple(f"{name}: {text}" for text in (*frame.warnings, *prediction.warnings))
    return _Finished(DepthMap.of(shown, displayed_frame(frame)), texts)


def _maps(batches: Generator[list[_Finished | Exception], None, None]) -> Iterator[DepthMap]:
    """The maps of batches, up to the first error."""
    with closing(batches):
        for found in (one for batch in batches for one in batch):
            if isinstance(found, Exception):
                raise found
            for text in found.warnings:
                warnings.warn(text, DepthcliWarning, stacklevel=2)
            yield found.depth


def _check_several(pictures: object, batch_size: int, workers: int) -> None:
    if batch_size < 1 or workers < 0:
        raise UsageError(f"a batch of {batch_size} by {workers} threads is none")
    is_single = getattr(pictures, "ndim", _BATCH_RANK) < _BATCH_RANK  # of arrays and tensors
    if is_single or isinstance(pictures, _SINGLE) or not hasattr(pictures, "__iter__"):
        raise UsageError(
            "predict_many takes several pictures, as a list, an iterator or an array of four axes",
            "use predict for one",
        )
