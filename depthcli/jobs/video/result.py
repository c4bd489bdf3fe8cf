"""What became of a video."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

from depthcli.io.writers.facts import SOFTWARE, Facts
from depthcli.video.rates import rate_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

    from depthcli.core.types import DepthMap, Frame


@dataclass(frozen=True, slots=True)
class VideoDone:
    """A video whose outputs are all written.

    Attributes:
        name: the video, as the user wrote it.
        outputs: the files written; a sequence's with ``%06d`` for the frame's number.
        numbers: those of the frames written, from 0 for the first of the file.
        rate: frames a second of the outputs, exact.
        source_rate: frames a second of the video.
        is_regular: whether all frames stand on the rate's grid.
        first: first frame written, without its pixels.
        depth: its depth, for kind and model.
        flicker: of the depth written, see ``FlickerMeter``; None without two alike frames.
        flicker_unsmoothed: of the depth before smoothing; None without smoothing.
        scenes: how many scenes there are.
        smooth_s: time constant of the smoothing.
        lock_s: time constant of the preview's range.
        scale: steps a metre in 16-bit outputs; None where each is stretched.
        provider: what ran the model.
        seconds: from opening the video to the last output.
        warnings: one-line texts.
        problem: why frames are missing at the end; None if none are.
    """

    name: str
    outputs: tuple[str, ...]
    numbers: Sequence[int]
    rate: Fraction
    source_rate: Fraction
    is_regular: bool
    first: Frame
    depth: DepthMap
    flicker: float | None
    flicker_unsmoothed: float | None
    scenes: int
    smooth_s: float
    lock_s: float
    scale: float | None
    provider: str
    seconds: float
    warnings: tuple[str, ...]
    problem: str | None

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
