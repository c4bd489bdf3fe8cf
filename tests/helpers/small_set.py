"""A data set in memory, and a predictor that plays back arrays."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from depthcli.core.types import DepthKind, DepthMap
from depthcli.lab.evaluation.predictors import Sample
from depthcli.lab.evaluation.report import Source
from helpers.in_memory import InMemory

HEIGHT, WIDTH = 12, 16


@dataclass
class SmallSet(InMemory):
    """Counts how often it is read."""

    ids: tuple[str, ...]
    scenes: tuple[str, ...]
    official_split: tuple[str, ...]
    depths_m: npt.NDArray[np.float32]
    raw_depths_m: npt.NDArray[np.float32]
    depth_reads: dict[int, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.ids)

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        return np.full((*self.depths_m.shape[1:], 3), i, np.uint8)

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        self.depth_reads[i] = self.depth_reads.get(i, 0) + 1
        return self.depths_m[i]

    def raw_depth_m(self, i: int) -> npt.NDArray[np.float32]:
        return self.raw_depths_m[i]


def small_set(
    count: int = 6, *, first: int = 0, shape: tuple[int, int] = (HEIGHT, WIDTH)
) -> SmallSet:
    """Random depth with pixels on both sides of the valid range, and holes in the raw depth."""
    rng = np.random.default_rng(count + first)
    depths_m = rng.uniform(0.4, 9.0, (count, *shape)).astype(np.float32)
    depths_m[rng.random(depths_m.shape) < 0.05] = 0
    depths_m[rng.random(depths_m.shape) < 0.02] = 10
    raw_m = np.where(rng.random(depths_m.shape) < 0.3, np.float32(0), depths_m)
    return SmallSet(
        ids=tuple(f"{first + i:04d}" for i in range(count)),
        scenes=tuple(f"room_{(first + i) // 2:04d}" for i in range(count)),
        official_split=tuple("train" if i % 2 else "test" for i in range(count)),
        depths_m=depths_m,
        raw_depths_m=raw_m,
    )


@dataclass
class Playback:
    """Gives stored maps by id."""

    maps: dict[str, npt.NDArray[np.float32]]
    kind: DepthKind = DepthKind.METRIC
    name: str = "playback"
    source: Source = Source.FILES
    stated: str = "metric, m"
    look: bool = False

    def predict(self, sample: Sample) -> DepthMap:
        if self.look:
            assert sample.frame.pixels[0, 0, 0] == int(sample.id) % 256
        return DepthMap(self.maps[sample.id], self.kind)


def noisy(
    dataset: SmallSet, *, shape: tuple[int, int] | None = None, seed: int = 5
) -> dict[str, npt.NDArray[np.float32]]:
    """Positive predictions that resemble the truth, of the truth's or another size."""
    rng = np.random.default_rng(seed)
    shape = shape or dataset.depths_m.shape[1:]
    base = dataset.depths_m[:, : shape[0], : shape[1]].clip(0.5, 9)
    noise = rng.lognormal(0.1, 0.4, base.shape)
    return dict(zip(dataset.ids, (base * noise).astype(np.float32), strict=True))
