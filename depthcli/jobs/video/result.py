"""What became of a video."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from depthcli.core.types import DepthMap, Frame
from depthcli.io.writers.facts import SOFTWARE, Facts
from depthcli.video.rates import rate_text


@dataclass(frozen=True, slots=True)
class VideoDone:
    """A video whose outputs are all written."""

    name: str  #: the video, as the user wrote it
    #: the files written; a sequence's with ``%06d`` for the frame's number
    outputs: tuple[str, ...]
    numbers: Sequence[int]  #: those of the frames written, from 0 for the first of the file
    rate: Fraction  #: frames a second of the outputs, exact
    source_rate: Fraction  #: frames a second of the video
    is_regular: bool  #: whether all frames stand on the rate's grid
    first: Frame  #: first frame written, without its pixels
    depth: DepthMap  #: its depth, for kind and model
    #: of the depth written, see ``FlickerMeter``; None without two alike frames
    flicker: float | None
    flicker_unsmoothed: float | None  #: of the depth before smoothing; None without smoothing
    scenes: int  #: how many scenes there are
    smooth_s: float  #: time constant of the smoothing
    lock_s: float  #: time constant of the preview's range
    scale: float | None  #: steps a metre in 16-bit outputs; None where each is stretched
    provider: str  #: what ran the model
    seconds: float  #: from opening the video to the last output
    warnings: tuple[str, ...]  #: one-line texts
    problem: str | None  #: why frames are missing at the end; None if none are

    @property
    def frames(self) -> int:
        """How many were written."""
        return len(self.numbers)

    def facts(self) -> dict[str, object]:
        """What the outputs mean, the same for every run: the fields of JSON and sidecar."""
        depth, known = self.depth, Facts.of(self.depth)
        return {
            "frames": self.frames,
            "fps": rate_text(self.rate),
            "source_fps": rate_text(self.source_rate),
            "constant_rate": self.is_regular,
            "first_frame": self.first.index,
            "start_s": self.first.timestamp_s,
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

    def sidecar(self) -> str:
        """The sidecar's text: what the outputs mean, the same for every run."""
        facts = {"software": SOFTWARE, **self.facts()}
        return json.dumps(facts, indent=2, allow_nan=False) + "\n"
