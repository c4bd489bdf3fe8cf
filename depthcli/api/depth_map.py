"""A depth map with methods to save, colour and back-project it."""

import html
import os
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, Literal, Self, TypeAlias, TypedDict, Unpack

import numpy as np

from depthcli.core import camera, types
from depthcli.core.options import Colormap, DepthFit, Near, chosen, short_repr
from depthcli.core.surface import PointCloud, surface_of
from depthcli.errors import DepthcliWarning, UsageError
from depthcli.io.formats import table
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.views import HtmlWriter
from depthcli.io.guard import Guard
from depthcli.io.images.png import encode_png
from depthcli.io.storage import atomic, paths
from depthcli.known.points import KnownDepth, fit_known_depth

AnchorLike: TypeAlias = camera.Anchor | tuple[int, int, float]
Anchors: TypeAlias = Sequence[AnchorLike] | types.AnyArray | types.DepthMap
CAMERA = ("focal_px", "hfov_deg", "centre_px")  #: options of all formats that have a camera
_RANK, _COLUMNS = 2, 3


def warn_all(texts: Iterable[str], name: object = "") -> None:
    """Warn, of what has a name if one is given, at the caller of the function that calls this."""
    for text in texts:
        warnings.warn(f"{name}: {text}" if name else text, DepthcliWarning, stacklevel=3)


class SaveOptions(TypedDict, total=False):
    """Types of the options of formats, for :meth:`DepthMap.save`; a test compares the names."""

    png_scale: float | None
    png_normalize: bool | None
    png_inverse: bool | None
    exr_channel: str | None
    half: bool | None
    colormap: str | None
    near: Literal["warm", "white", "black"] | None
    vmin: float | None
    vmax: float | None
    legend: bool | None
    side_by_side: bool | None
    stride: int | None
    max_depth_m: float | None
    max_error: float | None
    keep_edges: bool | None
    faces: bool | None
    stereo_layout: (
        Literal["side-by-side", "top-bottom", "half-side-by-side", "half-top-bottom", "anaglyph"]
        | None
    )
    eye_distance_m: float | None
    convergence_m: float | None
    focal_px: float | None
    hfov_deg: float | None
    centre_px: tuple[float, float] | None


@dataclass(frozen=True, slots=True, repr=False)
class DepthPage:
    """A page that shows a map in three dimensions; notebooks show it in a frame.

    Attributes:
        html: the text of the file.
    """

    html: str

    def _repr_html_(self) -> str:
        """The page in a frame of its own."""
        frame = '<iframe style="width: 100%; height: 600px; border: 0" srcdoc="{}"></iframe>'
        return frame.format(html.escape(self.html))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DepthMap(types.DepthMap):
    """Depth of every pixel of one image; NumPy's functions accept it as an array.

    Attributes:
        values: (H, W) float32. Metres for ``DepthKind.METRIC``. NaN where there is no depth.
        kind: what the numbers mean.
        provenance: model, camera and known points, as far as they are known.
        error: (H, W) float32, the expected |depth - true depth| by true depth; None if it was not
            estimated (``load_model(detail=Detail(error=True))``).
        frame: the image, upright; None if it is not available.
    """

    frame: types.Frame | None = None

    @classmethod
    def of(cls, depth: types.DepthMap, frame: types.Frame | None = None) -> Self:
        """Convert a map of the library's inner layers."""
        return cls(depth.values, depth.kind, depth.provenance, depth.error, frame)

    @property
    def model(self) -> str | None:
        """Name of the model; None if it is not known."""
        return self.provenance.model

    @property
    def focal_px(self) -> float | None:
        """Focal length that the metres were made for, in pixels of the map; None if unknown."""
        return self.provenance.focal_px

    @property
    def centre_px(self) -> tuple[float, float] | None:
        """Principal point in pixels of the map; None for the middle of the map."""
        return self.provenance.centre_px

    @property
    def camera_source(self) -> camera.CameraSource | None:
        """Where the focal length comes from: given, EXIF, the network, or the model's card."""
        return self.provenance.camera_source

    @property
    def time_s(self) -> float | None:
        """Time in its video, in seconds from the video's first frame; None for a still image."""
        return self.provenance.time_s

    @property
    def anchors(self) -> tuple[camera.Anchor, ...]:
        """The listed points that metres were fitted to; empty if known depth was a map."""
        return self.provenance.anchors

    @property
    def anchor_fit(self) -> types.AnchorFit | None:
        """Residual of the fit to known points; None if there was none."""
        return self.provenance.anchor_fit

    def fit_anchors(self, anchors: Anchors, *, fit: str = DepthFit.LOCAL) -> Self:
        """Metric depth that fits known points best.

        One point fits the scale, two or more also a shift. From five on, depth also follows them
        locally, and those that contradict the others are left out. A ``DepthcliWarning`` counts the
        pixels that lose their depth, as the fit puts them at or below 0 m, and the points outside.

        Args:
            anchors: one or more points (column, row, metres along the camera axis), as a list or an
                (N, 3) array, each taken at the nearest pixel; or a sparse map of the same aspect,
                (H, W) float metres or a metric ``DepthMap``, unknown where it is NaN or 0.
            fit: ``local``, or ``global`` for scale and shift alone.

        Raises:
            UsageError: the points do not fit the map, or contradict each other.
        """
        fitted, messages = fit_known_depth(self, known_depth_of(anchors, fit))
        warn_all(messages)
        return self.of(fitted, self.frame)

    def to_points(
        self,
        *,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
        centre_px: tuple[float, float] | None = None,
        stride: int = 1,
        max_depth_m: float | None = None,
        keep_edges: bool = True,
    ) -> PointCloud:
        """Pixels with depth as points in space, with the image's colours.

        Where predict had to assume the camera, points assume it too, with a ``DepthcliWarning``.

        Args:
            focal_px: focal length in pixels of the map; None for the one it was predicted with.
            hfov_deg: horizontal field of view in degrees, in place of ``focal_px``.
            centre_px: (cx, cy), the principal point, where (0, 0) is the middle of the first pixel;
                None for the one that the file of the map stated, else the middle of the map.
            stride: every n-th pixel of every n-th row.
            max_depth_m: leave out what is farther.
            keep_edges: keep the pixels of smeared edges, which are between near and far.

        Raises:
            UsageError: the map has no metres, no focal length is known, or one is not valid.
        """
        if not self.is_metric:
            raise UsageError(f"{self.kind} depth has no metres", "fit it to known points")
        depth = types.with_camera(self, camera.Intrinsics.given(focal_px, hfov_deg, centre_px))
        source = depth.provenance
        if source.focal_px is None and not source.projection.is_other:
            raise UsageError("no focal length is known; give focal_px or hfov_deg")
        if source.camera_source is camera.CameraSource.CARD:
            warn_all(["no focal length is known; the points assume the camera the model learned"])
        surface = surface_of(
            depth,
            source.focal_px or 1.0,  # of no meaning in a panorama
            stride=stride,
            max_depth_m=max_depth_m,
            keep_edges=keep_edges,
        )
        pixels = None if self.frame is None else self.frame.pixels_8bit()[::stride, ::stride]
        rgb = None if pixels is None else pixels[surface.valid]
        return PointCloud(surface.xyz_m[surface.valid], rgb)

    def colorize(
        self,
        colormap: str = "inferno",
        *,
        near: Literal["warm", "white", "black"] = "warm",
        vmin: float | None = None,
        vmax: float | None = None,
        legend: bool = False,
    ) -> types.UInt8Array:
        """The map in the colours of a colormap, over inverse depth.

        Args:
            colormap: ``inferno``, ``turbo``, ``magma``, ``viridis``, ``spectral`` or ``gray``.
            near: colour of the near end.
            vmin: low end of the colour range; None for percentile 2.
            vmax: high end of the colour range; None for percentile 98.
            legend: draw a colour bar at the right.

        Returns:
            (H, W, 3) RGB uint8; wider with a legend. Gray where there is no depth.

        Raises:
            UsageError: there is no such colormap, or no such end.
        """
        colours, end = chosen(Colormap, colormap, "colormap"), chosen(Near, near, "near")
        writer = PreviewWriter(colormap=colours, near=end, vmin=vmin, vmax=vmax, legend=legend)
        return writer.render(self)

    def view(
        self,
        *,
        stride: int | None = None,
        max_depth_m: float | None = None,
        keep_edges: bool = False,
        focal_px: float | None = None,
        hfov_deg: float | None = None,
    ) -> DepthPage:
        """A page with the map in three dimensions, which notebooks show; it works offline.

        Options are those of :meth:`save`; more than 640×480 points are thinned if ``stride`` is
        None.

        Raises:
            OutputError: the map has no metres, or no point within the limit.
        """
        depth = types.with_camera(self, camera.Intrinsics.given(focal_px, hfov_deg))
        writer = HtmlWriter(stride=stride, max_depth_m=max_depth_m, keep_edges=keep_edges)
        page, messages = writer.render(depth, self.frame)
        warn_all(messages)
        return DepthPage(page)

    def _repr_png_(self) -> bytes:
        """A preview, which notebooks show."""
        return encode_png(PreviewWriter().render(self))

    def save(
        self,
        path: str | os.PathLike[str] | BinaryIO,
        *,
        overwrite: bool = False,
        **options: Unpack[SaveOptions],
    ) -> None:
        """Write a file atomically; its suffix chooses the format.

        ``.png`` is 16 bit in millimetres, ``.preview.png`` a colour preview, ``.exr`` and ``.npy``
        metres in float32, ``.ply`` a point cloud, ``.glb`` and ``.usdz`` a mesh, ``.html`` a page
        to look at it, ``.normals.png`` surface normals, ``.stereo.png`` a stereo pair, ``.json``
        the metadata. If a format cannot store something, such as depth beyond its range, a
        ``DepthcliWarning`` says.

        Args:
            path: the file, whose missing folders are created; or one that is open for writing and
                has a name.
            overwrite: whether a file that depthcli did not write is replaced. A ``.npy`` does not
                say who wrote it.
            options: of the format, by the names of the command line, such as ``png_scale``,
                ``half`` or ``stride``; None for the default of one. ``focal_px`` or ``hfov_deg``,
                and ``centre_px``, are as for :meth:`to_points`; PNG, EXR and JSON store them.

        Raises:
            OutputError: it cannot be written, there is a file that depthcli did not write, or the
                map cannot be expressed in the format.
            UsageError: the suffix chooses no format, or an option is not for that format.
        """
        if isinstance(path, (str, os.PathLike)):
            file = paths.path_of(path)
        else:
            file = Path(str(getattr(path, "name", "an open file without a name")))
        name = table.format_of(file)
        if name is None:
            suffixes = ", ".join(table.FILE_SUFFIXES)
            raise UsageError(f"{file} has no suffix that selects a format; use {suffixes}")
        if not isinstance(path, (str, os.PathLike)):
            data, messages = self._encoded(name, options)
            path.write(data)
        else:
            depth, writer = self._writer(name, options)
            inputs = () if self.frame is None or self.frame.path is None else (self.frame.path,)
            Guard.of(inputs, overwrite=overwrite).check(file)
            with atomic.atomic_path(file) as temporary:
                messages = writer.write(depth, temporary, self.frame)
        warn_all(messages, file)

    def to_bytes(self, kind: str, **options: Unpack[SaveOptions]) -> bytes:
        """The content of a file of a format, such as ``png16``; else as :meth:`save`."""
        data, messages = self._encoded(chosen(table.Format, kind, "the format"), options)
        warn_all(messages)
        return data

    def _encoded(self, name: table.Format, options: SaveOptions) -> tuple[bytes, tuple[str, ...]]:
        depth, writer = self._writer(name, options)
        with atomic.temporary_folder() as folder:
            path = folder / f"depth{name.facts.suffix}"
            messages = writer.write(depth, path, self.frame)
            return path.read_bytes(), messages

    def _writer(
        self, name: table.Format, options: SaveOptions
    ) -> tuple[types.DepthMap, table.Writer]:
        """The map with a camera, and the writer of a format with its options."""
        values = table.with_members(options)
        depth = types.with_camera(
            self, camera.Intrinsics.given(*(values.pop(each, None) for each in CAMERA))
        )
        if depth is not self and not name.facts.has_camera:
            raise UsageError(f"{name.facts.suffix} states no camera", "leave it out")
        is_normalized = any(values.get(each) for each in ("png_normalize", "png_inverse"))
        used = {each for each, value in values.items() if value is not False}
        if others := used - {*name.facts.fields(is_normalized=is_normalized)}:
            raise UsageError(f"{min(others)} is not for {name.facts.suffix}")
        return depth, table.writer_class(name)(**{each: values[each] for each in used})


def known_depth_of(anchors: Anchors, fit: str | None) -> KnownDepth:
    """The points of :meth:`DepthMap.fit_anchors`, and their fit; UsageError if there is none."""
    if isinstance(anchors, types.DepthMap):
        if not anchors.is_metric:
            raise UsageError(f"known depth is in metres, and {anchors.kind} depth has none")
        points = KnownDepth.of_map(anchors.values)
    elif not isinstance(anchors, np.ndarray):
        try:
            rows = np.array([(x, y, depth_m) for x, y, depth_m in anchors], float).reshape(-1, 3)
        except (TypeError, ValueError) as error:
            problem = f"anchors are (column, row, metres), not {short_repr(anchors)}"
            raise UsageError(problem) from error
        points = KnownDepth.of_table(rows)
    elif anchors.shape[1:] == (_COLUMNS,) and anchors.dtype.kind in "fiu":
        points = KnownDepth.of_table(anchors)
    elif anchors.ndim == _RANK and anchors.dtype.kind == "f":
        points = KnownDepth.of_map(anchors).doubted()
    else:
        raise UsageError(
            "an array of anchors is (N, 3) numbers of column, row, metres, or (H, W) float metres, "
            f"not {anchors.shape} {anchors.dtype}"
        )
    return replace(points, fit=None if fit is None else chosen(DepthFit, fit, "the fit"))
