"""The pool of past fakes that a discriminator is trained on (Shrivastava et al. 2017)."""

import torch
from torch import Tensor


class ImagePool:
    """Stores the first images; then swaps each new one with a random stored one, with p = 0.5.

    With a size of 0, every image is returned unchanged. Images are swapped with others of their
    own size only.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.images: list[Tensor] = []

    def exchange(self, images: Tensor) -> Tensor:
        """New or past fakes (B, C, H, W), detached, for new ones (B, C, H, W)."""
        if self.size == 0:
            return images.detach()
        return torch.stack([self._exchange_one(image) for image in images.detach()])

    def _exchange_one(self, image: Tensor) -> Tensor:
        if len(self.images) < self.size:
            self.images.append(image.clone())
            return image
        if torch.rand(()) < 0.5:  # noqa: PLR2004
            return image
        alike = [i for i, past in enumerate(self.images) if past.shape == image.shape]
        if not alike:
            return image
        slot = alike[int(torch.randint(len(alike), ()))]
        past, self.images[slot] = self.images[slot], image.clone()
        return past
