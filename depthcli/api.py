"""The Python API: a model, the pictures it is given, and the depth maps that come back.

>>> import depthcli
>>> model = depthcli.load_model("default")
>>> depth = model.predict("docs/room.jpg", hfov_deg=70)
>>> depth.save("room.exr")
"""

from __future__ import annotations

import itertools
import operator
import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from depthcli.core import scaling, types
from depthcli.core.camera import Anchor
from depthcli.core.choices import PLAIN
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.core.point_cloud import point_cloud
from depthcli.errors import DepthcliWarning, UsageError
from depthcli.inference.pipeline import Pipeline, load
from depthcli.inference.providers import AUTO
from depthcli.io.depth import read as depth_files
from depthcli.io.pictures.any import frame_of
from depthcli.io.writers.by_suffix import write_depth
from depthcli.io.writers.preview import PreviewWriter, percentiles
from depthcli.models.places import DEFAULT_MODEL
from depthcli.video import depth as depth_videos
from depthcli.visual.colormaps import NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from typing import Literal, Self

    import numpy.typing as npt
    from matplotlib.axes import Axes

    from depthcli.core.choices import Detail
    from depthcli.core.point_cloud import PointCloud
    from depthcli.io.pictures.any import Picture
    from depthcli.models.card import ModelCard

    AnchorLike = Anchor | tuple[int, int, float]

_BATCH_RANK = 4
_SINGLE = (str, bytes, bytearray, memoryview, os.PathLike, types.Frame)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DepthMap(types.DepthMap):
    """Depth of every pixel of one picture; NumPy takes it for the array of its values.

    Attributes:
        values: (H, W) float32. Metres for ``DepthKind.METRIC``. NaN where there is no depth.
        kind: what the numbers mean.
        provenance: model, camera and anchors behind them, as far as they are known.
        frame: the picture, upright; None if it is not at hand.
    """

    frame: types.Frame | None = None

    @classmethod
    def of(cls, depth: types.DepthMap, frame: types.Frame | None = None) -> Self:
        """A map of the library's inner layers, with these methods."""
        return cls(depth.values, depth.kind, depth.provenance, frame)

    @property
    def valid(self) -> npt.NDArray[np.bool_]:
        """(H, W) bool: where there is a finite depth, for metres above 0."""
        finite = np.isfinite(self.values)
        return finite & (self.values > 0) if self.is_metric else finite

    @property
    def model(self) -> str | None:
        """Name of the model; None if it is not known."""
        return self.provenance.model if self.provenance else None

    @property
    def focal_px(self) -> float | None:
        """Focal length that the metres were made for, in pixels of the map; None if unknown."""
        return self.provenance.focal_px if self.provenance else None

    @property
    def camera_source(self) -> types.CameraSource | None:
        """Where the focal length comes from: given, EXIF, or assumed to be the model's own."""
        return self.provenance.camera_source if self.provenance else None

    @property
    def anchors(self) -> tuple[Anchor, ...]:
        """The known points that metres were fitted to."""
        return self.provenance.anchors if self.provenance else ()

    def fit_anchors(self, anchors: Sequence[AnchorLike]) -> Self:
        """Metric depth that fits known points best.

        One point fits the scale, two or more fit scale and shift.

        Args:
            anchors: (column, row, metres along the camera axis), one or more.

        Raises:
            UsageError: the points do not fit the map, or not each other.
        """
        points = [_anchor(anchor) for anchor in anchors]
        return self.of(scaling.fit_anchors(self, points), self.frame)

    def to_points(
        self,
        *,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
        centre_px: tuple[float, float] | None = None,
    ) -> PointCloud:
        """Every pixel with depth as a point in space, with the picture's colours.

        Where predict had to assume the camera, so does this, with a ``DepthcliWarning``.

        Args:
            focal_px: focal length in pixels of the map; None for the one it was predicted with.
            hfov_deg: horizontal field of view in degrees, in place of ``focal_px``.
            centre_px: (cx, cy), the principal point, where (0, 0) is the middle of the first pixel;
                None for the middle of the map.

        Raises:
            UsageError: the map has no metres, or no focal length is known.
        """
        scaling.check_camera(focal_px, hfov_deg)
        if hfov_deg is not None:
            focal_px = scaling.focal_px(hfov_deg, self.width)
        if focal_px is None and self.camera_source is types.CameraSource.CARD:
            told = "no focal length is known; the point cloud assumes the camera the model learned"
            warnings.warn(told, DepthcliWarning, stacklevel=2)
        focal_px = focal_px or self.focal_px
        if focal_px is None:
            raise UsageError("no focal length is known; give focal_px or hfov_deg to predict")
        return point_cloud(self, focal_px, centre_px=centre_px, frame=self.frame)

    def colorize(
        self,
        colormap: str = "inferno",
        *,
        near: Literal["warm", "white", "black"] = "warm",
        vmin: float | None = None,
        vmax: float | None = None,
        legend: bool = False,
    ) -> npt.NDArray[np.uint8]:
        """Colours for people, spread evenly over inverse depth.

        Args:
            colormap: ``inferno``, ``turbo``, ``magma``, ``viridis``, ``spectral`` or ``gray``.
            near: the near end of the colours.
            vmin: least depth with a colour of its own; None for percentile 2.
            vmax: largest one; None for percentile 98.
            legend: draw a scale at the right.

        Returns:
            (H, W, 3) RGB uint8; wider with a legend. Gray where there is no depth.

        Raises:
            UsageError: there is no such colormap.
        """
        if colormap not in NAMES:
            raise UsageError(f"no colormap named {colormap!r}; choose {', '.join(NAMES)}")
        return PreviewWriter(colormap, near, vmin, vmax, legend).render(self)

    def plot(
        self,
        axes: Axes | None = None,
        *,
        colormap: str = "inferno",
        vmin: float | None = None,
        vmax: float | None = None,
    ) -> Axes:
        """Draw the map with matplotlib, near is warm, with a colour bar in its unit.

        Args:
            axes: where to draw; None for new ones.
            colormap: a name that matplotlib knows.
            vmin: depth at one end of the bar; None for percentile 2.
            vmax: depth at the other end; None for percentile 98.

        Raises:
            UsageError: matplotlib is not installed.
        """
        try:
            from matplotlib import pyplot as plt  # noqa: PLC0415 - it need not be installed
        except ModuleNotFoundError as error:
            raise UsageError(
                f"plot() needs matplotlib: pip install matplotlib ({error})"
            ) from error
        axes = plt.subplots()[1] if axes is None else axes
        low, high = percentiles(self)
        colours = plt.get_cmap(colormap)
        drawn = axes.imshow(
            self.values,
            cmap=colours if self.kind is types.DepthKind.INVERSE else colours.reversed(),
            vmin=low if vmin is None else vmin,
            vmax=high if vmax is None else vmax,
        )
        axes.figure.colorbar(drawn, ax=axes, label="depth (m)" if self.is_metric else self.kind)
        return axes

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        png_scale: float | None = None,
        exr_channel: str | None = None,
        half: bool | None = None,
    ) -> None:
        """Write a file, whole or not at all; its suffix chooses the format.

        ``.png`` is 16 bit in millimetres, ``.preview.png`` colours for people, ``.exr`` and
        ``.npy`` metres in float32, ``.ply`` a point cloud, ``.json`` the facts. What a format
        cannot hold, depth beyond its range say, is told as a ``DepthcliWarning``.

        Args:
            path: the file; missing folders are made.
            png_scale: steps per metre of a PNG; None for 1000.
            exr_channel: name of the channel of an EXR; None for the usual one.
            half: 16-bit floats in an EXR.

        Raises:
            OutputError: it cannot be written, or the map cannot be expressed in the format.
            UsageError: the suffix chooses no format, or an option is of another one.
        """
        options = {"png_scale": png_scale, "exr_channel": exr_channel, "half": half}
        told = write_depth(self, Path(path), self.frame, options)
        for text in told:
            warnings.warn(f"{path}: {text}", DepthcliWarning, stacklevel=2)


class DepthModel:
    """A model, ready for pictures; safe to share among threads.

    Attributes:
        pipeline: what does the work, frame by frame.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline

    @property
    def card(self) -> ModelCard:
        """What the model takes, gives and learned."""
        return self.pipeline.card

    @property
    def provider(self) -> str:
        """The execution provider that really runs it, ``cpu`` say."""
        return self.pipeline.session.provider

    def __repr__(self) -> str:
        return f"<DepthModel {self.card.name} {self.card.version}, {self.provider}>"

    def predict(
        self,
        picture: Picture,
        *,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
        anchors: Sequence[AnchorLike] = (),
    ) -> DepthMap:
        """Depth of every pixel of a picture.

        Args:
            picture: a path; the bytes of a file; an array (H, W) gray or (H, W, 3) RGB of uint8,
                uint16 or float32 in [0, 1], whose alpha is dropped; a PIL picture; a ``Frame``.
            focal_px: focal length in pixels of the picture.
            hfov_deg: horizontal field of view in degrees, in place of ``focal_px``. With neither,
                the 35-mm focal length in the picture's EXIF is used, if it is there, else the
                camera that the model learned is assumed; ``camera_source`` of the map says which.
            anchors: known points, to fit metres to; see :meth:`DepthMap.fit_anchors`.

        Returns:
            (H, W) of the upright picture.

        Raises:
            InputError: the picture cannot be read, or is none.
            ModelError: the network failed.
            UsageError: the camera or the anchors make no sense for this model and picture.
        """
        self.pipeline.check_focal(focal_px, hfov_deg)
        frame = frame_of(picture)
        depth = self.pipeline.predict(frame, focal_px=focal_px, hfov_deg=hfov_deg)
        return _fitted(DepthMap.of(depth, frame), anchors)

    def predict_many(
        self,
        pictures: Iterable[Picture],
        *,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
        anchors: Sequence[AnchorLike] = (),
        batch_size: int = 1,
        workers: int = 0,
    ) -> Iterator[DepthMap]:
        """Depth of a stream of pictures of one camera, in their order and in constant memory.

        Args:
            pictures: as in :meth:`predict`; of any number, read when their turn comes.
            focal_px: as in :meth:`predict`.
            hfov_deg: as in :meth:`predict`.
            anchors: as in :meth:`predict`.
            batch_size: pictures that go through the network together, which helps a GPU.
            workers: threads; 0 works in the calling thread and never reads ahead. With more, twice
                as many batches are read ahead, so a live camera wants 0 and a folder its cores.

        Returns:
            An iterator that gives one map a picture. What :meth:`predict` raises, it raises at that
            picture's turn, and ends.

        Raises:
            UsageError: the camera makes no sense, or it is one picture in place of several.
        """
        self.pipeline.check_focal(focal_px, hfov_deg)
        _check_several(pictures, batch_size, workers)

        def batch(some: Sequence[Picture]) -> list[DepthMap]:
            frames = [frame_of(picture) for picture in some]
            depths = self.pipeline.predict_many(frames, focal_px=focal_px, hfov_deg=hfov_deg)
            return [
                _fitted(DepthMap.of(depth, frame), anchors)
                for depth, frame in zip(depths, frames, strict=True)
            ]

        done = ordered_map(batch, _batches(pictures, batch_size), workers=workers)
        return itertools.chain.from_iterable(done)


class DepthVideo(depth_videos.DepthVideo):
    """A 16-bit gray video of depth, whose frames have the methods of :class:`DepthMap`."""

    def __iter__(self) -> Iterator[DepthMap]:
        """Depth maps, from the beginning, with one in memory."""
        return map(DepthMap.of, super().__iter__())


def load_model(
    model: str | os.PathLike[str] = DEFAULT_MODEL,
    *,
    provider: str = AUTO,
    threads: int | None = None,
    detail: Detail = PLAIN,
    provider_options: Mapping[str, str] | None = None,
) -> DepthModel:
    """Find a model and make it ready.

    Args:
        model: a name in the catalog, a folder, or an ``.onnx`` file.
        provider: ``auto`` for the best that works, or a name such as ``cpu`` or ``cuda`` that has
            to be there.
        threads: threads within one run of the network; None for all cores.
        detail: how depth becomes that of a full-size picture.
        provider_options: for a provider asked for by name, as onnxruntime documents them.

    Raises:
        ModelError: the model is not there or is damaged.
        ProviderError: the named provider is not available.
        UsageError: no provider has that name, or it takes no options and some are given.
    """
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


def read_depth(path: str | os.PathLike[str], *, png_scale: float | None = None) -> DepthMap:
    """Depth of a 16-bit PNG, EXR or NPY file, with what the file states of model and camera.

    Args:
        path: the file; its suffix says its format.
        png_scale: steps per metre of a PNG; None for what the file says of itself, or millimetres.

    Raises:
        InputError: missing, damaged, or without depth.
    """
    return DepthMap.of(depth_files.read_depth(Path(path), png_scale=png_scale))


def _anchor(point: AnchorLike) -> Anchor:
    try:
        x, y, depth_m = point
        return Anchor(operator.index(x), operator.index(y), float(depth_m))
    except (TypeError, ValueError) as error:
        raise UsageError(f"an anchor is (column, row, metres), not {point!r}") from error


def _fitted(depth: DepthMap, anchors: Sequence[AnchorLike]) -> DepthMap:
    return depth.fit_anchors(anchors) if anchors else depth


def _batches(pictures: Iterable[Picture], size: int) -> Iterator[list[Picture]]:
    rest = iter(pictures)
    while batch := list(itertools.islice(rest, size)):
        yield batch


def _check_several(pictures: object, batch_size: int, workers: int) -> None:
    if batch_size < 1 or workers < 0:
        raise UsageError("batch_size is at least 1 and workers at least 0")
    is_array = isinstance(pictures, np.ndarray) and pictures.ndim < _BATCH_RANK
    if is_array or isinstance(pictures, _SINGLE) or not hasattr(pictures, "__iter__"):
        raise UsageError(
            "predict_many takes several pictures, in a list say (an array of them has four axes); "
            "predict takes one"
        )
