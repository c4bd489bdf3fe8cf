"""The Python API: a model that predicts depth maps of images.

>>> import depthcli
>>> model = depthcli.load_model()
>>> depth = model.predict("docs/room.jpg", hfov_deg=70)
>>> depth.save("room.exr")
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from typing import TypeAlias

from depthcli.api.depth_map import Anchors, DepthMap, known_depth_of, warn_all
from depthcli.core import options, parallel, types
from depthcli.core.camera import Intrinsics
from depthcli.errors import UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import AUTO
from depthcli.io.images.pixels import check_levels
from depthcli.io.images.read import ImageLike, frame_of
from depthcli.jobs.image import ImageJob, ImageResult, ImageTask
from depthcli.known.points import KnownDepth
from depthcli.models.card import ModelCard

_Task: TypeAlias = tuple[ImageLike | Exception, KnownDepth | None]


def _own(
    tasks: Iterable[tuple[ImageLike, KnownDepth | None]], white_level: int | None
) -> Iterator[_Task]:
    """Each image with its points; the last may be an error of the iterator in place of an image.

    Pixels in memory are copied, since the caller may overwrite a buffer, or close a PIL image,
    before they are processed. Files are not read.
    """
    try:
        for image, points in tasks:
            if isinstance(image, (bytearray, memoryview)):
                yield bytes(image), points
            elif isinstance(image, (str, bytes, os.PathLike)):
                yield image, points
            else:
                frame = frame_of(image, white_level)
                is_own = frame is not image
                yield frame if is_own else replace(frame, pixels=frame.pixels.copy()), points
    except Exception as error:  # noqa: BLE001 - raised at its position
        yield error, None


_Displayed: TypeAlias = tuple[DepthMap, tuple[str, ...]]
_BATCH_RANK = 4
_SINGLE = (str, bytes, bytearray, memoryview, os.PathLike, types.Frame)


def load_model(
    model: str | os.PathLike[str] | None = None,
    *,
    provider: str = AUTO,
    threads: int | None = None,
    detail: options.UpsamplingOptions = options.DEFAULT_UPSAMPLING,
    provider_options: Mapping[str, str] | None = None,
) -> DepthModel:
    """Find and load a model.

    Args:
        model: a name in the catalog, a folder, or an ``.onnx`` file; None for ``default``, which
            ``prompted`` replaces where two or more points are known.
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
    session = SessionLoader(model, provider, threads, provider_options or {}).load()
    warn_all(session.warnings)
    return DepthModel(Pipeline(session, detail))


class DepthModel:
    """A loaded model; thread-safe.

    Attributes:
        pipeline: the layer below, which takes frames.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        self._job = ImageJob(pipeline)

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
        image: ImageLike,
        *,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
        anchors: Anchors | None = None,
        anchors_fit: str | None = None,
        white_level: int | None = None,
    ) -> DepthMap:
        """Depth of every pixel of an image.

        Args:
            image: a file's name, path or URI (a ``Path`` is never fetched); its bytes, or the file
                open for reading; an array (H, W) gray or (H, W, 3) RGB of uint8, uint16 or floats
                in [0, 1], or with alpha; a PIL image; a ``Frame``.
            focal_px: focal length in pixels of the image.
            hfov_deg: horizontal field of view in degrees, in place of ``focal_px``. With neither,
                the 35-mm focal length in the image's EXIF is used, if it has one, else the camera
                that the model learned is assumed; ``camera_source`` of the map states which.
            anchors: known points that metres are fitted to; see :meth:`DepthMap.fit_anchors`. None
                for no fit.
            anchors_fit: ``global``: scale and shift alone; ``local``: then also what these leave;
                ``network``: by a model that takes known depth; None for the last of these that is
                possible. The map's ``anchor_fit`` states which.
            white_level: value of white in a 16-bit image, such as 4095 for data of 12 bits; None
                for 65535. Not for a ``Frame``, whose white is 65535.

        Returns:
            (H, W) of the upright image; of an EXR, of its display window.

        Raises:
            InputError: the image cannot be read, or is not an image, or the known points do
                not fit it.
            ModelError: the network failed.
            UsageError: the camera, the known points or the white level are not valid.
        """
        camera = Intrinsics.given(focal_px, hfov_deg)
        points = None if anchors is None else known_depth_of(anchors, anchors_fit)
        frame = frame_of(image, white_level)
        depth, texts = _displayed(self._job.run(ImageTask(frame, camera, points)), frame)
        warn_all(texts)
        return depth

    def predict_many(
        self,
        images: Iterable[ImageLike],
        *,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
        anchors: Anchors | None = None,
        anchors_each: Iterable[Anchors | None] | None = None,
        anchors_fit: str | None = None,
        white_level: int | None = None,
        batch_size: int = 1,
        workers: int = 0,
    ) -> Iterator[DepthMap]:
        """Depth of a stream of images of one camera, in their order and in constant memory.

        Args:
            images: as in :meth:`predict`, like the other arguments; read when they are needed.
            focal_px: of all of them.
            hfov_deg: of all of them.
            anchors: of all of them.
            anchors_each: in place of ``anchors``, those of each image, None for none.
            anchors_fit: of all of them.
            white_level: of all of them.
            batch_size: images in one run of the network, which is faster on a GPU.
            workers: threads; 0 works in the calling thread and never reads ahead, which suits a
                live camera. N read ahead 2 N batches; use all cores for a folder.

        Returns:
            An iterator of one map an image. An error of :meth:`predict`, or of the iterator of
            images, is raised at its position, after the maps before it, and ends the iterator.

        Raises:
            UsageError: the camera or white level is not valid, or ``images`` is a single one.
        """
        camera = Intrinsics.given(focal_px, hfov_deg)
        points = None if anchors is None else known_depth_of(anchors, anchors_fit)
        check_levels(white_level)
        if batch_size < 1 or workers < 0:
            raise UsageError("give a batch_size of 1 or more, and workers of 0 or more")
        is_single = getattr(images, "ndim", _BATCH_RANK) < _BATCH_RANK  # of arrays and tensors
        if is_single or isinstance(images, _SINGLE) or not hasattr(images, "__iter__"):
            raise UsageError("predict_many takes several images", "use predict for one")
        if not (anchors is None or anchors_each is None):
            raise UsageError("give anchors of all images, or of each, not both")
        points_each: Iterable[KnownDepth | None] = itertools.repeat(points)
        if anchors_each is not None:
            points_each = (
                None if a is None else known_depth_of(a, anchors_fit) for a in anchors_each
            )

        def predicted(batch: list[_Task]) -> list[_Displayed | Exception]:
            tasks, problem = list[ImageTask](), list[Exception]()
            try:
                for image, of_image in batch:
                    if isinstance(image, Exception):
                        raise image  # noqa: TRY301 - ended as by one that cannot be read
                    frame = (
                        image if isinstance(image, types.Frame) else frame_of(image, white_level)
                    )
                    tasks.append(ImageTask(frame, camera, of_image))
            except Exception as error:  # noqa: BLE001 - raised at its position
                problem.append(error)
            results = zip(self._job.run_many(tasks), tasks, strict=True)
            maps = (
                done if isinstance(done, Exception) else _displayed(done, task.frame)
                for done, task in results
            )
            return [*maps, *problem]

        each = _own(zip(images, points_each, strict=anchors_each is not None), white_level)
        batches = iter(lambda: list(itertools.islice(each, batch_size)), [])
        return _maps(parallel.ordered_map(predicted, batches, workers=workers))


def _displayed(done: ImageResult, frame: types.Frame) -> _Displayed:
    """The map in the display window, and warnings."""
    texts = done.named_warnings(str(frame.path or "an image"))
    return DepthMap.of(done.depth, types.displayed_frame(frame)), texts


def _maps(batches: Generator[list[_Displayed | Exception], None, None]) -> Iterator[DepthMap]:
    """The maps of batches, up to the first error."""
    with closing(batches):
        for done in (each for batch in batches for each in batch):
            if isinstance(done, Exception):
                raise done
            depth, texts = done
            warn_all(texts)
            yield depth
