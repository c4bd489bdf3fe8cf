"""A Progress that tests look at."""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class Watched:
    """It remembers all that it is told, and may end the work after some frames."""

    last: int | None = None
    begun: list[tuple[str, int | None, str]] = field(default_factory=list)
    counts: list[list[int]] = field(default_factory=list)
    """Of each stage, the units done each time."""

    @property
    def done(self) -> int:
        """Units of all stages."""
        return sum(map(sum, self.counts))

    @property
    def stages(self) -> dict[str, tuple[int | None, int]]:
        """Of each stage, the units announced and done."""
        stages = zip(self.begun, self.counts, strict=True)
        return {what: (total, sum(counts)) for (what, total, _), counts in stages}

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[int], None]:
        counts: list[int] = []
        self.begun.append((what, total, unit))
        self.counts.append(counts)

        def advance(count: int) -> None:
            counts.append(count)
            before = sum(counts) - count
            if self.last is not None and unit == "frames" and before < self.last <= before + count:
                raise KeyboardInterrupt

        return advance
