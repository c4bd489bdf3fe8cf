"""Encoders of timm with the decoder of the efficient generator."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from depthcli.errors import CheckpointError, UsageError
from depthcli.lab.training.config import GeneratorConfig
from depthcli.lab.training.networks.efficient import DecodingGenerator

STRIDES = (2, 4, 8, 16, 32)
_EXAMPLE_PX = 64
_COUNTERS = "num_batches_tracked"


class EncoderGenerator(DecodingGenerator):
    """Network input to raw depth at half its size, with an encoder of timm.

    The encoder has feature maps at stride 32 and, if possible, at strides 2, 4, 8 and 16. Unless
    ``norm`` is ``batch``, its own norm is folded into its weights.
    """

    def __init__(self, config: GeneratorConfig, channels: int = 1) -> None:
        super().__init__()
        encoder, norm = str(config.encoder), config.norm
        network = timm_features(encoder, channels)
        info = network.feature_info
        widths = dict(zip(info.reduction(), info.channels(), strict=True))
        if STRIDES[-1] not in widths:
            raise UsageError(f"{encoder} has no feature maps at strides of 2 to 32: choose another")
        self.name, self.channels, self.folds = encoder, channels, norm != "batch"
        self.encoder: nn.Module = folded_norms(network, channels) if self.folds else network
        self.strides = tuple(widths)
        self.TAPS = tuple(f"stride{stride}" for stride in STRIDES[:-1] if stride in widths)
        self._add_decoder([widths.get(n, 0) for n in STRIDES], config, norm=norm != "none")

    def _encode(self, x: Tensor) -> tuple[list[Tensor | None], Tensor]:
        if not x.is_cuda:  # as the weights, see Run
            x = x.contiguous(memory_format=torch.channels_last)
        maps = dict(zip(self.strides, self.encoder(x), strict=True))
        return [maps.get(stride) for stride in STRIDES[:-1]], maps[STRIDES[-1]]

    def load_encoder(self, weights: Path | None) -> None:
        """Load pretrained weights of the encoder; None downloads those of timm's hub.

        A file is a state dict for images of three channels, in the order of timm's network; further
        tensors, such as a classifier's, are ignored.
        """
        network = timm_features(self.name, 3, pretrained=weights is None)
        if weights is not None:
            network.load_state_dict(_in_order(network.state_dict(), weights), strict=False)
        stem = next(m for m in network.modules() if isinstance(m, nn.Conv2d))
        _accept_input(stem, self.channels, network.default_cfg["std"])
        if self.folds:
            network = folded_norms(network, self.channels)
        self.encoder.load_state_dict(network.state_dict())


class SamePaddedConv2d(nn.Conv2d):
    """TensorFlow's "same" padding, which timm computes from the size, in a form that exports."""

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, out_channels, ceil(H/stride), ceil(W/stride))."""
        if torch.onnx.is_in_onnx_export():
            return _PaddedConvolution.apply(x, self.weight, self.bias, self)  # type: ignore[no-untyped-call, no-any-return]
        return self.padded(x)

    def padded(self, x: Tensor) -> Tensor:
        """Convolution of the padded input."""
        above, left, below, right = self.zeros
        x = F.pad(x, (left, right, above, below))
        return F.conv2d(x, self.weight, self.bias, self.stride, 0, self.dilation, self.groups)

    @property
    def zeros(self) -> tuple[int, ...]:
        """Rows and columns of padding above, left, below and right."""
        whole = [(n - 1) * gap for n, gap in zip(self.kernel_size, self.dilation, strict=True)]
        before = [max(0, n + 1 - step) // 2 for n, step in zip(whole, self.stride, strict=True)]
        return (*before, *(n - first for n, first in zip(whole, before, strict=True)))


class _PaddedConvolution(torch.autograd.Function):
    """One operator in the exported graph, which int8 needs, in place of padding and convolution."""

    @staticmethod
    def forward(_: Any, x: Tensor, *arguments: Any) -> Tensor:  # noqa: ANN401
        conv: SamePaddedConv2d = arguments[-1]
        return conv.padded(x)

    @staticmethod
    def symbolic(graph: Any, x: Any, weight: Any, bias: Any, conv: SamePaddedConv2d) -> Any:  # noqa: ANN401
        inputs = [x, weight] if bias is None else [x, weight, bias]
        sizes = {"strides_i": conv.stride, "pads_i": conv.zeros, "dilations_i": conv.dilation}
        return graph.op("Conv", *inputs, group_i=conv.groups, **sizes)


def timm_features(name: str, channels: int, *, pretrained: bool = False) -> Any:  # noqa: ANN401
    """Feature maps of a model of timm, newly initialized."""
    timm = _import_timm()
    if not timm.is_model(name.partition(".")[0]):
        raise UsageError(f"timm has no model '{name}': see timm.list_models()")
    options = {"features_only": True, "in_chans": channels, "pretrained": pretrained}
    try:
        network = timm.create_model(name, **options)
    except (RuntimeError, AttributeError, OSError) as error:
        raise UsageError(f"timm cannot make an encoder of {name}: {error}") from error
    for conv in network.modules():
        if type(conv).__name__ == "Conv2dSame":
            conv.__class__ = SamePaddedConv2d
    return network


def folded_norms(network: nn.Module, channels: int) -> nn.Module:
    """The network in evaluation mode, with batch norm folded into the convolutions before it."""
    network.eval()
    names = {module: name for name, module in network.named_modules()}
    for conv, norm in list(_conv_norms(network, channels)):
        network.set_submodule(names[conv], fuse_conv_bn_eval(conv, norm))
        network.set_submodule(names[norm], getattr(norm, "act", nn.Identity()))
    return network


@torch.no_grad()
def _conv_norms(network: nn.Module, channels: int) -> Iterator[tuple[nn.Conv2d, nn.BatchNorm2d]]:
    """Convolutions and the batch norms that take their outputs, found by running the network."""
    producers: dict[int, tuple[nn.Conv2d, Tensor]] = {}
    pairs: dict[nn.Conv2d, nn.BatchNorm2d] = {}

    def note(module: nn.Module, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        if isinstance(module, nn.Conv2d):
            producers[id(output)] = module, output  # kept, so that its id is not used again
        elif id(inputs[0]) in producers:
            pairs[producers[id(inputs[0])][0]] = module  # type: ignore[assignment]

    kinds = (nn.Conv2d, nn.BatchNorm2d)
    modules = [module for module in network.modules() if isinstance(module, kinds)]
    hooks = [module.register_forward_hook(note) for module in modules]
    network(torch.zeros(1, channels, _EXAMPLE_PX, _EXAMPLE_PX))
    for hook in hooks:
        hook.remove()
    yield from pairs.items()


def _in_order(expected: Mapping[str, Tensor], path: Path) -> dict[str, Tensor]:
    """Tensors of a weight file under the names of a network, assigned by their order."""
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
        tensors = [value for name, value in stored.items() if _COUNTERS not in name]
    except Exception as error:  # a file that is not a pickle can raise anything
        raise CheckpointError(f"{path} is not a state dict of torch") from error
    names = [name for name in expected if _COUNTERS not in name]
    for name, value in zip(names, tensors, strict=False):
        if expected[name].shape != value.shape:
            shapes = f"{tuple(expected[name].shape)}, not {tuple(value.shape)}"
            raise CheckpointError(f"{path} does not fit the encoder: {name} is {shapes}")
    if len(tensors) < len(names):
        raise CheckpointError(f"{path} does not fit the encoder: it lacks {names[len(tensors)]}")
    return dict(zip(names, tensors, strict=False))


def _accept_input(stem: nn.Conv2d, channels: int, std: Sequence[float]) -> None:
    """Make a convolution that took (rgb - mean) / std take 1 or 3 channels in [-1, 1]."""
    weight = stem.weight.detach() * (0.5 / torch.tensor(std)).view(1, -1, 1, 1)
    stem.weight = nn.Parameter(weight.sum(1, keepdim=True) if channels == 1 else weight)
    stem.in_channels = channels


def _import_timm() -> Any:  # noqa: ANN401
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import timm  # noqa: PLC0415 - slow, and only for this network
        except RuntimeError:  # torchvision of another build than torch
            _declare_vision_operators()
            import timm  # noqa: PLC0415
    return timm


_VISION = torch.library.Library("torchvision", "FRAGMENT")  # type: ignore[no-untyped-call]


def _declare_vision_operators() -> None:
    """Declare operators that torchvision's import needs, and no encoder.

    PyPI has torchvision for CUDA only, whose compiled operators do not load beside torch for CPUs.
    """
    for name in ("nms", "qnms"):
        _VISION.define(  # type: ignore[no-untyped-call]
            f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"
        )
