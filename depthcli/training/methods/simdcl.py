"""SimDCL (Han et al. 2021): DCLGAN whose fakes are, as a whole, similar to their domain."""

from typing import ClassVar

from torch import Tensor, nn

from depthcli.training.config.schema import TrainConfig
from depthcli.training.losses.similarity import similarity
from depthcli.training.methods.base import not_none, present
from depthcli.training.methods.dclgan import DclGan, Sides
from depthcli.training.networks.similarity_map import SimilarityMap


class SimDcl(DclGan):
    """DCLGAN + the distance of one vector an image, fake from real, in both domains."""

    TERMS: ClassVar = DclGan.TERMS | {"similarity"}

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        taps, compares = len(self.taps), bool(self.weights.similarity)
        self.map_real_x = SimilarityMap(taps) if compares else None
        self.map_fake_y = SimilarityMap(taps) if compares else None
        self.map_real_y = SimilarityMap(taps) if compares else None
        self.map_fake_x = SimilarityMap(taps) if compares else None

    def heads(self) -> list[nn.Module]:
        """The patch heads and the four maps."""
        maps = not_none(self.map_real_x, self.map_fake_y, self.map_real_y, self.map_fake_x)
        return super().heads() + maps

    def _compared(self, maps: Sides) -> dict[str, Tensor]:
        vectors = self._vectors(maps)
        if not self.weights.similarity:
            return self._contrast(vectors)
        # A domain has no positions in common with its fakes: theirs are drawn again.
        fake_x, _ = present(self.sampler_gray)(maps.fake_x)
        fake_y, _ = present(self.sampler_depth)(maps.fake_y)
        alike = similarity(
            real_x=present(self.map_real_x)(vectors.real_x),
            fake_x=present(self.map_fake_x)(fake_x),
            real_y=present(self.map_real_y)(vectors.real_y),
            fake_y=present(self.map_fake_y)(fake_y),
        )
        return self._contrast(vectors) | {"similarity": self.weights.similarity * alike}
