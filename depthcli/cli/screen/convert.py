"""What a conversion cost, as text and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from depthcli.cli.screen import console
from depthcli.core.text import one_line

if TYPE_CHECKING:
    from depthcli.core.types import DepthMap


class RoundTrip(NamedTuple):
    """How far what is read back is from what was written, in the map's unit.

    All are None for a format that is not read back.

    Attributes:
        max_error: largest distance.
        mean_error: mean distance.
        lost: pixels that no longer have depth.
    """

    max_error: float | None = None
    mean_error: float | None = None
    lost: int | None = None

    @classmethod
    def of(cls, depth: DepthMap, again: DepthMap) -> RoundTrip:
        """The distance of two maps of one size."""
        here, there = np.isfinite(depth.values), np.isfinite(again.values)
        both = here & there
        gap = np.abs(depth.values[both].astype(np.float64) - again.values[both])
        lost = int((here & ~there).sum())
        return cls(*(float(gap.max()), float(gap.mean())) if gap.size else (0.0, 0.0), lost)


class Converted(NamedTuple):
    """A file that was converted.

    Attributes:
        source: the input, as the user wrote it.
        target: the output, as the user wrote it.
        depth: what was written.
        round_trip: what that cost.
        warnings: one-line texts.
    """

    source: str
    target: str
    depth: DepthMap
    round_trip: RoundTrip
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, object]:
        """The object of ``--json``."""
        return {
            "input": self.source,
            "output": self.target,
            "unit": "m" if self.depth.is_metric else None,
            **self.round_trip._asdict(),
            "warnings": list(self.warnings),
        }

    def tell(self) -> None:
        """Say it in one line, and the warnings."""
        line = f"{self.source} -> {self.target}"
        largest, mean, lost = self.round_trip
        if largest is not None:
            unit = " m" if self.depth.is_metric else ""
            line += (
                f"  round trip: max error {largest:.3g}{unit}, "
                f"mean {mean:.3g}{unit}, {lost} pixels lost"
            )
        console.out(one_line(line))
        for warning in self.warnings:
            console.warn(warning)
