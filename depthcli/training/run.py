"""Networks, optimizers and weight average of one run: steps, saving and resuming."""

import copy
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn
from torch.optim import Optimizer

from depthcli.errors import CheckpointError, TrainingError
from depthcli.training.checkpoint import Checkpoint, TrainState
from depthcli.training.config import OptimConfig, TrainConfig
from depthcli.training.data import TrainingBatch
from depthcli.training.devices import average_gradients, gather_states
from depthcli.training.init_weights import load_init_weights
from depthcli.training.methods.base import Method, Phase
from depthcli.training.methods.registry import build_method
from depthcli.training.networks.encoder import EncoderGenerator
from depthcli.training.provenance import (
    DataProvenance,
    config_differences,
    data_differences,
    mismatch_error,
)

_RANK_STRIDE = 1_000_003  # between the seeds of processes, far from those that users choose
_ACCELERATORS = {"cuda": torch.cuda, "mps": torch.mps}
_ADVICE = (
    "lower optim.learning_rate or use precision=32-true, and go on from the last checkpoint, "
    "which is kept"
)


class Run:
    """Networks, optimizers and weight average of one run.

    ``steps`` is the number of steps of the whole schedule, ``state`` how far the run has come.
    """

    optimizers: dict[Phase, Optimizer]

    def __init__(self, config: TrainConfig, fabric: Fabric, steps_per_epoch: int) -> None:
        fabric.seed_everything(config.seed, verbose=False)
        self.config, self.fabric, self.steps_per_epoch = config, fabric, steps_per_epoch
        self.steps = config.optim.epochs * steps_per_epoch
        self.state, self.provenance = TrainState(), DataProvenance()
        self.method = build_method(config)
        self.method.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        phases = [phase for phase in self.method.phases if self.method.networks(phase)]
        optimizers = [build_optimizer(self.method, phase, config.optim) for phase in phases]
        self.rates = {
            phase: [group["lr"] for group in o.param_groups]
            for phase, o in zip(phases, optimizers, strict=True)
        }
        self.module, *ready = fabric.setup(self.method, *optimizers)
        self.optimizers = dict(zip(phases, ready, strict=True))
        decay = config.optim.ema
        self.average = WeightAverage(self.method.generator, decay) if decay else None
        if fabric.global_rank:  # the same weights, but other dropout, patches and pools
            torch.manual_seed(config.seed + _RANK_STRIDE * fabric.global_rank)

    @property
    def ema_generator(self) -> nn.Module:
        """The network that is validated: the weight average, if there is one."""
        return self.average.network if self.average else self.method.generator

    def load_init_weights(self, paths: Sequence[Path]) -> None:
        """Load the mean weights of exported models or checkpoints.

        Raises:
            CheckpointError: they do not fit.
            ModelError: a model cannot be read.
        """
        self.provenance = load_init_weights(self.method.generator, paths, self.provenance)
        if self.average:
            self.average = WeightAverage(self.method.generator, self.config.optim.ema)

    def step(self, batch: TrainingBatch) -> dict[str, float]:
        """One optimization step of every phase; the loss terms by name.

        Raises:
            TrainingError: a term is not finite.
        """
        share = lr_factor(self.config.optim, self.state.step, self.steps_per_epoch)
        self.method.share_done = self.state.step / self.steps
        losses: dict[str, Tensor] = {}
        for phase, optimizer in self.optimizers.items():
            for group, rate in zip(optimizer.param_groups, self.rates[phase], strict=True):
                group["lr"] = share * rate
            terms: dict[str, Tensor] = self.module(batch, phase)
            losses |= {name: term.detach() for name, term in terms.items()}
            optimizer.zero_grad()
            self.fabric.backward(torch.stack(list(terms.values())).sum())
            average_gradients(self.fabric, _weights(optimizer))
            if self.config.optim.clip_norm and phase == "generator":
                limit = self.config.optim.clip_norm
                # A loss that is not finite is an error below, which names it; the scaler of
                # half precision skips steps whose gradients alone are not.
                self.fabric.clip_gradients(
                    self.module, optimizer, max_norm=limit, error_if_nonfinite=False
                )
            optimizer.step()
        if self.average:
            self.average.update(self.method.generator, self.state.step + 1)
        return finite_losses(losses, self.fabric)

    def save(self, path: Path) -> None:
        """Write a checkpoint from rank 0; all processes must call this.

        Raises:
            CheckpointError: it cannot be written; the previous one is kept.
            TrainingError: a weight is not finite; the previous one is kept.
        """
        self.check_weights()
        own = process_state(self.method, self.fabric.device)
        others = gather_states(self.fabric, own)
        if not self.fabric.is_global_zero:
            return
        Checkpoint(
            config=self.config,
            state=self.state,
            provenance=self.provenance,
            method=self.method.state_dict(),
            ema_generator=self.average.network.state_dict() if self.average else None,
            optimizers={phase: o.state_dict() for phase, o in self.optimizers.items()},
            precision=self.fabric.strategy.precision.state_dict(),
            others=others,
            **own,
        ).save(path)

    def check_weights(self) -> None:
        """Check the weights before they are saved: a finite loss can have a gradient that is not.

        Raises:
            TrainingError: a weight is not finite; the message names its network and the step.
        """
        for name, network in self.method.named_children():
            finite = [weight.isfinite().all() for weight in network.state_dict().values()]
            if finite and not bool(torch.stack(finite).all()):
                problem = f"a weight of '{name}' is not finite after step {self.state.step}"
                raise TrainingError(problem, _ADVICE)

    def resume(self, path: Path) -> None:
        """Restore the state of a checkpoint, if there is one.

        Raises:
            CheckpointError: it belongs to another configuration, other data, or another number of
                processes.
        """
        if not path.exists():
            return
        saved = Checkpoint.load(path)
        mismatches = config_differences(saved.config, self.config)
        mismatches += data_differences(saved.provenance, self.provenance)
        if mismatches:
            raise mismatch_error(path, mismatches)
        devices = len(saved.others) + 1
        if devices != self.fabric.world_size:
            raise CheckpointError(
                f"{path} belongs to a run on {devices} devices", "give as many {devices}"
            )
        try:
            self._load(saved)
        except (LookupError, RuntimeError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"{path} does not fit the networks of its own configuration", "give another {out}"
            ) from error
        self.state, self.provenance = saved.state, saved.provenance

    def _load(self, saved: Checkpoint) -> None:
        self.method.load_state_dict(saved.method)
        for phase, optimizer in self.optimizers.items():
            # Learning rates and the like come from the configuration, not from the file.
            own_groups = optimizer.state_dict()["param_groups"]
            state = saved.optimizers[phase]["state"]
            optimizer.load_state_dict({"state": state, "param_groups": own_groups})
        if self.average:
            self.average.network.load_state_dict(saved.ema_generator or {})
        if saved.precision:
            self.fabric.strategy.precision.load_state_dict(saved.precision)
        first = {"rng": saved.rng, "device_rng": saved.device_rng, "extra": saved.extra}
        own = [first, *saved.others][self.fabric.global_rank]
        load_process_state(self.method, self.fabric.device, own)


class WeightAverage:
    """Exponential moving average (EMA) of a network's weights.

    Each update keeps the fraction ``decay`` of the average, less in the first steps, so that the
    random initial weights have little influence. ``network`` has the average, in evaluation mode.
    """

    def __init__(self, network: nn.Module, decay: float) -> None:
        self.network = copy.deepcopy(network).eval().requires_grad_(False)
        self.decay = decay

    @torch.no_grad()
    def update(self, network: nn.Module, step: int) -> None:
        """Update the average with the weights after a step, counted from 1."""
        decay = min(self.decay, step / (step + 9))
        now = network.state_dict()
        for name, average in self.network.state_dict().items():
            if average.dtype.is_floating_point:
                average.lerp_(now[name].to(average.dtype), 1 - decay)
            else:
                average.copy_(now[name])


def build_optimizer(method: Method, phase: Phase, optim: OptimConfig) -> Optimizer:
    """AdamW over the networks of a phase, which is Adam where nothing decays."""
    networks, heads = method.networks(phase), method.heads() if optim.head_learning_rate else []
    body = [network for network in networks if network not in heads]
    encoders = [network.encoder for network in body if isinstance(network, EncoderGenerator)]
    groups = _parameter_groups([p for network in body for p in _parts(network)], optim.weight_decay)
    for group in _parameter_groups(encoders, optim.weight_decay):
        groups.append(group | {"lr": optim.learning_rate * optim.encoder_rate})
    own = {"lr": optim.head_learning_rate, "betas": (optim.head_beta1, optim.head_beta2)}
    heads = [network for network in networks if network in heads]
    groups += [group | own for group in _parameter_groups(heads, optim.weight_decay)]
    return torch.optim.AdamW(groups, optim.learning_rate, (optim.beta1, optim.beta2))


def _parts(network: nn.Module) -> list[nn.Module]:
    """The network, or its parts without an encoder of timm."""
    if not isinstance(network, EncoderGenerator):
        return [network]
    return [part for part in network.children() if part is not network.encoder]


def _parameter_groups(networks: list[nn.Module], weight_decay: float) -> list[dict[str, Any]]:
    """Kernels and matrices, which decay, and the rest, which does not."""
    weights = [w for network in networks for w in network.parameters()]
    groups: list[dict[str, Any]] = [
        {"params": [w for w in weights if w.ndim > 1], "weight_decay": weight_decay},
        {"params": [w for w in weights if w.ndim <= 1], "weight_decay": 0.0},
    ]
    return [group for group in groups if group["params"]]


def _weights(optimizer: Optimizer) -> list[Tensor]:
    return [weight for group in optimizer.param_groups for weight in group["params"]]


def lr_factor(optim: OptimConfig, step: int, steps_per_epoch: int) -> float:
    """Factor on the learning rate at a step, counted from 0 over the whole run.

    ``linear`` is 1 for c epochs, then falls over d to zero: 1 − max(0, e+1−c)/(d+1); ``cosine`` is
    half a cosine over all steps. Either is multiplied by a ramp over ``optim.warmup_steps``.
    """
    ramp = min(1.0, (step + 1) / optim.warmup_steps) if optim.warmup_steps else 1.0
    if optim.schedule == "linear":
        past = max(0, step // steps_per_epoch + 1 - optim.epochs_constant)
        return ramp * (1.0 - past / (optim.epochs_decay + 1))
    steps = optim.epochs * steps_per_epoch
    return ramp * 0.5 * (1.0 + math.cos(math.pi * min(step, steps) / steps))


def finite_losses(losses: dict[str, Tensor], fabric: Fabric) -> dict[str, float]:
    """The loss terms as floats, averaged over the processes, in one transfer from the device.

    Raises:
        TrainingError: one of them is not finite; the message names it.
    """
    together = torch.stack([term.detach().float() for term in losses.values()])
    if fabric.world_size > 1:
        together = fabric.all_reduce(together, reduce_op="mean")  # type: ignore[assignment]
    values = dict(zip(losses, together.tolist(), strict=True))
    for name, value in values.items():
        if not math.isfinite(value):
            raise TrainingError(f"the loss term '{name}' became {value}", _ADVICE)
    return values


def process_state(method: Method, device: torch.device) -> dict[str, Any]:
    """State that differs between processes, on the CPU, by the checkpoint's keys."""
    accelerator = _ACCELERATORS.get(device.type)
    return {
        "rng": torch.get_rng_state(),
        "device_rng": accelerator.get_rng_state(device) if accelerator else None,
        "extra": {
            name: [image.cpu() for image in images] for name, images in method.extra_state().items()
        },
    }


def load_process_state(method: Method, device: torch.device, state: dict[str, Any]) -> None:
    """Restore a state returned by :func:`process_state`."""
    method.load_extra_state(
        {name: [image.to(device) for image in images] for name, images in state["extra"].items()}
    )
    torch.set_rng_state(state["rng"])
    accelerator, saved = _ACCELERATORS.get(device.type), state["device_rng"]
    # The states of different kinds of accelerators, between which a run can move, differ in size.
    if accelerator and saved is not None and len(saved) == len(accelerator.get_rng_state(device)):
        accelerator.set_rng_state(saved, device)
