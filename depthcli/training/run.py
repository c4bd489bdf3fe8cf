"""Networks, optimisers and average of one run: a step, a checkpoint, and back."""

from collections.abc import Sequence
from pathlib import Path

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from depthcli.errors import CheckpointError
from depthcli.training.average import WeightAverage
from depthcli.training.checkpoint import Checkpoint, RunProgress
from depthcli.training.config.schema import TrainConfig
from depthcli.training.config_differences import another_run, data_differences, differences
from depthcli.training.data.batches import TrainingBatch
from depthcli.training.devices import average_gradients, of_others
from depthcli.training.finite import check_weights, finite_losses
from depthcli.training.initial import start_from
from depthcli.training.methods.base import Phase
from depthcli.training.methods.registry import build_method
from depthcli.training.optimizers import build_optimizer
from depthcli.training.process_state import own_state, take_up
from depthcli.training.schedule import factor

_RANK_STRIDE = 1_000_003  # seeds of further processes, far from those that people choose


class Run:
    """Networks, optimisers and average of one run.

    ``steps`` are those of the whole schedule, ``progress`` says how far it has come.
    """

    optimizers: dict[Phase, torch.optim.Optimizer]

    def __init__(self, config: TrainConfig, fabric: Fabric, steps_per_epoch: int) -> None:
        fabric.seed_everything(config.seed, verbose=False)
        self.config, self.fabric, self.steps_per_epoch = config, fabric, steps_per_epoch
        self.steps = config.optim.epochs * steps_per_epoch
        self.progress = RunProgress()
        self.method = build_method(config)
        if not _instance_norm(self.method):
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
        if fabric.global_rank:  # the same weights, but dropout, patches and pools of its own
            torch.manual_seed(config.seed + _RANK_STRIDE * fabric.global_rank)

    @property
    def best_generator(self) -> nn.Module:
        """The network that is validated: the average, where there is one."""
        return self.average.network if self.average else self.method.generator

    def start_from(self, paths: Sequence[Path]) -> str:
        """Start from the mean weights of exported models or checkpoints; what they are.

        Raises:
            CheckpointError: they do not fit.
        """
        started = start_from(self.method.generator, paths)
        if self.average:
            self.average = WeightAverage(self.method.generator, self.config.optim.ema)
        return started

    def step(self, batch: TrainingBatch) -> dict[str, float]:
        """One optimisation step of every phase; the loss terms by name.

        Raises:
            TrainingError: a term is not finite.
        """
        share = factor(self.config.optim, self.progress.step, self.steps_per_epoch)
        self.method.share_done = self.progress.step / self.steps
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
                self.fabric.clip_gradients(self.module, optimizer, max_norm=limit)
            optimizer.step()
        if self.average:
            self.average.update(self.method.generator, self.progress.step + 1)
        return finite_losses(losses, self.fabric)

    def save(self, path: Path) -> None:
        """Write a checkpoint; every process takes part, the first one writes.

        Raises:
            CheckpointError: it cannot be written; the one before is kept.
            TrainingError: a weight is not finite; the one before is kept.
        """
        check_weights(self.method, self.progress.step)
        own = own_state(self.method, self.fabric.device)
        others = of_others(self.fabric, own)
        if not self.fabric.is_global_zero:
            return
        Checkpoint(
            config=self.config,
            progress=self.progress,
            method=self.method.state_dict(),
            average=self.average.network.state_dict() if self.average else None,
            optimizers={phase: o.state_dict() for phase, o in self.optimizers.items()},
            precision=self.fabric.strategy.precision.state_dict(),
            others=others,
            **own,
        ).save(path)

    def resume(self, path: Path) -> None:
        """Take up the state of a checkpoint, if there is one.

        Raises:
            CheckpointError: it belongs to another configuration, other data, or another number of
                processes.
        """
        if not path.exists():
            return
        saved = Checkpoint.load(path)
        strange = differences(saved.config, self.config)
        strange += data_differences(saved.progress, self.progress)
        if strange:
            raise another_run(path, strange)
        devices = len(saved.others) + 1
        if devices != self.fabric.world_size:
            raise CheckpointError(
                f"{path} belongs to a run on {devices} devices: give --devices {devices}"
            )
        try:
            self._take_up(saved)
        except (AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"{path} does not fit the networks of its own configuration: give another --out"
            ) from error
        self.progress = saved.progress

    def _take_up(self, saved: Checkpoint) -> None:
        self.method.load_state_dict(saved.method)
        for phase, optimizer in self.optimizers.items():
            state = saved.optimizers[phase]["state"]
            _check_state(state, _weights(optimizer))
            # Rates and the like follow from the configuration, whatever the file says.
            own_groups = optimizer.state_dict()["param_groups"]
            optimizer.load_state_dict({"state": state, "param_groups": own_groups})
        if self.average:
            self.average.network.load_state_dict(saved.average or {})
        if saved.precision:
            self.fabric.strategy.precision.load_state_dict(saved.precision)
        first = {"rng": saved.rng, "device_rng": saved.device_rng, "extra": saved.extra}
        own = [first, *saved.others][self.fabric.global_rank]
        take_up(self.method, self.fabric.device, own)


def _instance_norm(method: nn.Module) -> bool:
    """Whether channels-last would give wrong gradients.

    torch (2.13 still) reads a channels-last gradient as a contiguous one in the backward pass of
    instance norm when the batch is one picture.
    """
    return any(isinstance(layer, nn.InstanceNorm2d) for layer in method.modules())


def _check_state(state: dict[int, dict[str, object]], weights: list[Tensor]) -> None:
    """Refuse moments that are not of their weights; torch would notice at the next step.

    Raises:
        ValueError: they are of another shape.
    """
    for place, kept in state.items():
        for value in kept.values():
            if isinstance(value, Tensor) and value.ndim and value.shape != weights[place].shape:
                raise ValueError(place)


def _weights(optimizer: torch.optim.Optimizer) -> list[Tensor]:
    return [weight for group in optimizer.param_groups for weight in group["params"]]
