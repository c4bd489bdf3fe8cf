"""The pool of past fakes that a discriminator is shown (Shrivastava et al. 2017)."""

import torch
from torch import Tensor


class ImagePool:
    """Fill, then with probability one half swap each new image for a random stored one.

    A size of 0 hands every image straight through.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.images: list[Tensor] = []

    def exchange(self, images: Tensor) -> Tensor:
        """(B, C, H, W) fakes in, (B, C, H, W) fresh or past fakes out, detached."""
        if self.size == 0:
            return images.detach()
        return torch.stack([self._exchange_one(image) for image in images.detach()])

    def _exchange_one(self, image: Tensor) -> Tensor:
        if len(self.images) < self.size:
            self.images.append(image.clone())
            return image
        if torch.rand(()) < 0.5:  # noqa: PLR2004
            return image
        slot = int(torch.randint(self.size, ()))
        past, self.images[slot] = self.images[slot], image.clone()
        return past
