"""The 70×70 PatchGAN discriminator (Isola et al. 2017)."""

import itertools

from torch import Tensor, nn

from depthcli.training.networks.blur import BlurDown
from depthcli.training.networks.instance_norm import InstanceNorm
from depthcli.training.networks.weights import init_normal, init_xavier

_SLOPE = 0.2


class PatchGan(nn.Module):
    """One logit for every 70×70 patch of an image.

    ``width``, the channels of the first layer, is doubled three times. ``antialias`` replaces
    strides by stride-1 convolutions with blur (the CUT family).
    """

    def __init__(self, width: int = 64, *, antialias: bool = False) -> None:
        super().__init__()
        widths = (1, width, 2 * width, 4 * width, 8 * width)
        layers: list[nn.Module] = []
        for i, (inputs, outputs) in enumerate(itertools.pairwise(widths)):
            shrinks = i < 3  # noqa: PLR2004 - the last two layers keep the size
            stride = 2 if shrinks and not antialias else 1
            layers.append(nn.Conv2d(inputs, outputs, 4, stride, 1))
            if i:
                layers.append(InstanceNorm(outputs))
            layers.append(nn.LeakyReLU(_SLOPE))
            if shrinks and antialias:
                layers.append(BlurDown(outputs))
        layers.append(nn.Conv2d(widths[-1], 1, 4, 1, 1))
        self.layers = nn.Sequential(*layers)
        (init_xavier if antialias else init_normal)(self)

    def forward(self, image: Tensor) -> Tensor:
        """Logits of an image: (B, 1, 256, 256) to (B, 1, 30, 30), and so on."""
        return self.layers(image)  # type: ignore[no-any-return]
