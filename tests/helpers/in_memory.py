"""What a data set of arrays in memory has in common with one of files."""

from depthcli.core.types import Frame
from depthcli.lab.datasets.base import Pair


class InMemory:
    """Base of data sets that have ``ids``, ``scenes`` and ``official_split`` as attributes."""

    focal_px: tuple[float, ...] = ()
    scales: tuple[float, ...] = ()
    hfov_deg: float | None = None
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def pairs(self) -> tuple[Pair, ...]:
        ones = self.scales or (1.0,) * len(self.ids)
        return tuple(Pair(name, scale=scale) for name, scale in zip(self.ids, ones, strict=True))

    def frame(self, i: int) -> Frame:
        return Frame(self.image(i))

    def files(self, i: int) -> list:
        del i
        return []
