"""The result of processing a video."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from depthcli.core.types import DepthMap, Frame
from depthcli.io.formats.metadata import SOFTWARE, DepthMetadata
from depthcli.video.rates import rate_text
from depthcli.video.time_code import time_code_text


@dataclass(frozen=True, slots=True)
class VideoResult:
    """The result of a video whose outputs are all written."""

    name: str  #: the video, as the user wrote it
    #: the files written; a sequence's with ``%06d`` for the frame's number
    outputs: tuple[str, ...]
    numbers: Sequence[int]  #: numbers of the frames written; the first of the file has 0
    times_s: Sequence[float]  #: time of each of them, from the first frame of the video
    rate: Fraction  #: frames per second of the outputs, exact
    source_rate: Fraction  #: frames per second of the video
    is_regular: bool  #: whether the frame rate is constant
    first: Frame  #: first frame written, without its pixels
    depth: DepthMap  #: its depth, for kind and model
    #: flicker of the depth written, see ``FlickerMeter``; None without two similar frames
    flicker: float | None
    flicker_unsmoothed: float | None  #: flicker before smoothing; None without smoothing
    scenes: int  #: number of scenes
    smooth_s: float  #: time constant of the smoothing
    lock_s: float  #: time constant of the preview's range
    scale: float | None  #: units per metre in 16-bit outputs; None if each is normalized
    provider: str  #: the provider that ran the model
    seconds: float  #: from opening the video to the last output
    warnings: tuple[str, ...]  #: one line each
    problem: str | None  #: why frames are missing at the end; None if none are

    @property
    def frames(self) -> int:
        """Number of frames written."""
        return len(self.numbers)

    def metadata(self) -> dict[str, object]:
        """The fields of JSON and sidecar that are the same for every run."""
        depth, known = self.depth, DepthMetadata.of(self.depth)
        time_code = self.first.time_code
        return {
            "frames": self.frames,
            "fps": rate_text(self.rate),
            "source_fps": rate_text(self.source_rate),
            "constant_rate": self.is_regular,
            "first_frame": self.first.index,
            "start_s": self.first.timestamp_s,
            "time_code": None if time_code is None else time_code_text(time_code, self.source_rate),
            "width": depth.width,
            "height": depth.height,
            "orientation": self.first.orientation,
            "kind": known.kind,
            "unit": known.unit,
            "scale": self.scale if depth.is_metric else None,
            "scenes": self.scenes,
            "flicker": self.flicker,
            "flicker_unsmoothed": self.flicker_unsmoothed,
            "smooth_s": self.smooth_s,
            "lock_s": self.lock_s,
            **known.origin(),
        }

    def sidecar(self, *, has_times: bool) -> str:
        """The text of the sidecar, the same for every run.

        With ``has_times``, it also states the time of each frame by its number, for numbered files.
        """
        metadata = {"software": SOFTWARE, **self.metadata()}
        if has_times:
            metadata["times_s"] = dict(zip(self.numbers, self.times_s, strict=True))
        return json.dumps(metadata, indent=2, allow_nan=False) + "\n"
