"""Depth files and videos for the Python API: maps with its methods, and warnings."""

import os
from collections.abc import Iterator
from pathlib import Path

from depthcli.api.depth_map import DepthMap, warn_all
from depthcli.core import camera, types
from depthcli.core.options import AS_STATED, MAX_PIXELS, DepthEncoding, Eye, ReadOptions, chosen
from depthcli.errors import InputError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.storage.paths import path_of
from depthcli.io.stored.depth import DepthReadOptions
from depthcli.video import depth_video as depth_videos, source as video_frames
from depthcli.video.container import InputPipe
from depthcli.video.frames import WHOLE, Span


class DepthVideo(depth_videos.DepthVideo):
    """A 16-bit gray video of depth, whose frames have the methods of :class:`DepthMap`."""

    def __iter__(self) -> Iterator[DepthMap]:
        """Depth maps from the beginning, one in memory at a time."""
        return map(DepthMap.of, super().__iter__())


class VideoSource(video_frames.VideoSource):
    """Frames of a video; a ``DepthcliWarning`` tells what is wrong with it."""

    def __init__(
        self,
        source: str | Path | InputPipe,
        *,
        max_pixels: int = MAX_PIXELS,
        stream: int | None = None,
        eye: Eye | None = None,
        options: ReadOptions = AS_STATED,
    ) -> None:
        """Open the video, with a warning if its colours or times are doubtful."""
        options = options if eye is None else options._replace(eye=eye)
        super().__init__(source, max_pixels=max_pixels, stream=stream, options=options)
        warn_all(self.warnings, source)

    def frames(self, span: Span = WHOLE) -> Iterator[types.Frame]:
        """Frames of a span, with a warning at the end if any are missing."""
        yield from super().frames(span)
        if self.problem is not None:
            warn_all([self.problem], self._source)


def read_depth(
    path: str | os.PathLike[str],
    *,
    png_scale: float | None = None,
    kind: str | None = None,
    focal_px: float | None = None,
    hfov_deg: float | None = None,
    centre_px: tuple[float, float] | None = None,
    baseline_m: float | None = None,
    layer: str | None = None,
    frame: int | None = None,
) -> DepthMap:
    """Depth of a file in any format that is read, with its metadata about model and camera.

    Values that are no depth (infinity; metres of 0 or less) are NaN.
    A ``DepthcliWarning`` tells if the sidecar beside it is that of another map, or if a PNG states
    no scale and none is given.

    Args:
        path: the file, with the suffix of its format.
        png_scale: units per metre; None for what the file states, else millimetres in a PNG and
            metres in floats. Integers in an NPY file need it to be metric.
        kind: meaning of the numbers in a file that does not state it: ``metric`` (along the camera
            axis; None is the same), ``distance`` (along the ray), ``relative``, ``inverse``
            (1/depth, metric with a scale) or ``disparity`` (in pixels).
        focal_px: focal length in pixels, which distance and disparity need.
        hfov_deg: horizontal field of view in degrees, in place of ``focal_px``.
        centre_px: principal point, for distance; None for the middle.
        baseline_m: distance of the two cameras in metres, for disparity.
        layer: layer or part of an EXR; None for the likeliest.
        frame: index of the map, from 0, in NPY or NPZ with several.

    Raises:
        InputError: missing, damaged, without depth, metric integers without a scale, or distance
            or disparity without a camera.
        UsageError: there is no such kind, or the camera is not valid.
    """
    options = DepthReadOptions(
        png_scale,
        None if kind is None else chosen(DepthEncoding, kind, "kind"),
        camera=camera.Intrinsics.given(focal_px, hfov_deg, centre_px),
        baseline_m=baseline_m,
        layer=layer,
        frame=frame,
    )
    path = path_of(path)
    if path.suffix.lower() == ".mkv":
        raise InputError(f"{path} is a video; depthcli.DepthVideo reads the maps in it")
    stored = read_stored_depth(path, options)
    warn_all(stored.warnings_with_scale("png_scale"))
    return DepthMap.of(stored.displayed)
