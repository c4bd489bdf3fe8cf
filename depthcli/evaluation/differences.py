"""Paired differences between two rows, with confidence intervals."""

from dataclasses import dataclass

from depthcli.metrics.choices import Alignment


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean and its 95 % confidence interval."""

    mean: float
    low: float  #: NaN if the interval is not known
    high: float  #: NaN if the interval is not known

    @property
    def is_significant(self) -> bool:
        """Whether zero is outside the interval."""
        return self.low > 0 or self.high < 0


@dataclass(frozen=True, slots=True)
class Difference:
    """One row's scores minus another's, on the same pictures."""

    name: str  #: the row that is subtracted from
    other: str  #: the row that is subtracted
    alignment: Alignment | None  #: of both
    #: of every metric, in the order of the table; below 0, ``name`` is better where lower is better
    intervals: tuple[Interval, ...]
    scene_count: int  #: scenes of the pictures, which are resampled
