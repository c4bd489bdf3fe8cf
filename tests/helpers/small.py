"""Small networks with weights that matter, and checkpoints of them."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime
import torch
from torch import nn

from depthcli.lab.training.checkpoint import Checkpoint
from depthcli.lab.training.config import DataConfig, GeneratorConfig, OutputConfig, TrainConfig
from depthcli.lab.training.networks.build import build_generator
from depthcli.lab.training.provenance import DataProvenance, TrainState

EFFICIENT = GeneratorConfig(
    name="efficient", encoder=(4, 8, 8, 8, 8), decoder=(8, 8, 8, 4), depths=(1, 2, 1, 1)
)
RESNET = GeneratorConfig(name="resnet", width=8, blocks=2, residual="stem")
ANTIALIASED = GeneratorConfig(name="resnet", width=4, blocks=1, residual="none", antialias=True)
INPUT_RESIDUAL = GeneratorConfig(name="resnet", width=4, blocks=1, residual="input")
ALL = {
    "efficient": EFFICIENT,
    "resnet": RESNET,
    "antialiased": ANTIALIASED,
    "input residual": INPUT_RESIDUAL,
}


def small_network(config: GeneratorConfig = EFFICIENT, seed: int = 0) -> nn.Module:
    """A network whose every weight and statistic counts: fresh ones hold many zeros and ones."""
    torch.manual_seed(seed)
    network = build_generator(config)
    for name, tensor in network.state_dict().items():
        if name.endswith("running_var"):
            tensor.uniform_(0.5, 2)
        elif tensor.is_floating_point():
            fan = tensor[0].numel() if tensor.ndim > 1 else 10
            tensor.normal_(0, (1.5 / fan) ** 0.5)
            if tensor.ndim == 1 and name.endswith("weight"):
                tensor.add_(1)
    return network.eval()


def run_onnx(model: onnx.ModelProto, image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """What ONNX Runtime computes of (N, C, H, W) on the CPU."""
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    output: npt.NDArray[np.float32] = session.run(None, {"image": image})[0]
    return output


def write_checkpoint(
    path: Path,
    network: nn.Module | None = None,
    generator: GeneratorConfig = EFFICIENT,
    average: nn.Module | None = None,
    **facts: Any,
) -> Path:
    """A checkpoint as training writes it, of a run at 48×32; facts of its data by name."""
    state: dict[str, Any] = {"step": 12, "epoch": 3, "seconds": 90.0, "scores": {"abs_rel": 0.25}}
    state |= {name: facts.pop(name) for name in (*state, "threads") if name in facts}
    network = network or small_network(generator)
    config = TrainConfig(
        seed=7,
        generator=generator,
        output=OutputConfig(coding="log"),
        data=DataConfig(width=48, height=32),
    )
    checkpoint = Checkpoint(
        config=config,
        state=TrainState(**state),
        provenance=DataProvenance(**facts),
        method={f"generator.{name}": value for name, value in network.state_dict().items()},
        ema_generator=average.state_dict() if average else None,
        optimizers={},
        extra={},
        rng=torch.get_rng_state(),
    )
    checkpoint.save(path)
    return path
