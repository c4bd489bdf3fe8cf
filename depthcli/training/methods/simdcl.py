"""SimDCL (Han et al. 2021): DCLGAN with a similarity loss between real and fake images."""

from typing import ClassVar

from torch import Tensor, nn

from depthcli.training.config.schema import TrainConfig
from depthcli.training.losses.similarity import similarity
from depthcli.training.methods.base import present, required
from depthcli.training.methods.dclgan import DclGan, DomainFeatures
from depthcli.training.networks.similarity_map import SimilarityMap


class SimDcl(DclGan):
    """DCLGAN + the distance between one vector per real and per fake image, in both domains."""

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
        maps = present(self.map_real_x, self.map_fake_y, self.map_real_y, self.map_fake_x)
        return super().heads() + maps

    def _contrastive_terms(self, maps: DomainFeatures) -> dict[str, Tensor]:
        vectors = self._patch_vectors(maps)
        if not self.weights.similarity:
            return self._contrast(vectors)
        # Fakes share no positions with the real images of their domain: sample new ones.
        fake_x, _ = required(self.sampler_gray)(maps.fake_x)
        fake_y, _ = required(self.sampler_depth)(maps.fake_y)
        alike = similarity(
            real_x=required(self.map_real_x)(vectors.real_x),
            fake_x=required(self.map_fake_x)(fake_x),
            real_y=required(self.map_real_y)(vectors.real_y),
            fake_y=required(self.map_fake_y)(fake_y),
        )
        return self._contrast(vectors) | {"similarity": self.weights.similarity * alike}
