"""Networks, optimizers and weight average of one run: steps, saving and resuming."""

from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from depthcli.errors import CheckpointError
from depthcli.training.average import WeightAverage
from depthcli.training.checkpoint import Checkpoint, TrainState
from depthcli.training.config.schema import TrainConfig
from depthcli.training.data.batches import TrainingBatch
from depthcli.training.devices import average_gradients, gather_states
from depthcli.training.finite import check_weights, finite_losses
from depthcli.training.initial_weights import load_init_weights
from depthcli.training.methods.base import Phase
from depthcli.training.methods.registry import build_method
from depthcli.training.optimizers import build_optimizer
from depthcli.training.process_state import load_process_state, process_state
from depthcli.training.provenance import (
    DataProvenance,
    config_differences,
    data_differences,
    mismatch_error,
)
from depthcli.training.schedule import lr_factor

_RANK_STRIDE = 1_000_003  # between the seeds of processes, far from those that users choose


class Run:
    """Networks, optimizers and weight average of one run.

    ``steps`` is the number of steps of the whole schedule, ``state`` how far the run has come.
    """

    optimizers: dict[Phase, torch.optim.Optimizer]

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
        if (
            fabric.global_rank
        ):  # the same weights, but other random numbers (dropout, patches, pools)
            torch.manual_seed(config.seed + _RANK_STRIDE * fabric.global_rank)

    @property
    def ema_generator(self) -> nn.Module:
        """The network that is validated: the weight average, if there is one."""
        return self.average.network if self.average else self.method.generator

    def load_init_weights(self, paths: Sequence[Path], pictures: Callable[[], Tensor]) -> str:
        """Load the mean weights of exported models or checkpoints; returns their origin.

        ``pictures`` is as for :func:`depthcli.training.initial_weights.load_init_weights`.

        Raises:
            CheckpointError: they do not fit.
        """
        started = load_init_weights(self.method.generator, paths, pictures)
        if self.average:
            self.average = WeightAverage(self.method.generator, self.config.optim.ema)
        return started

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
        check_weights(self.method, self.state.step)
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
        except (AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
            raise CheckpointError(
                f"{path} does not fit the networks of its own configuration", "give another {out}"
            ) from error
        self.state, self.provenance = saved.state, saved.provenance

    def _load(self, saved: Checkpoint) -> None:
        self.method.load_state_dict(saved.method)
        for phase, optimizer in self.optimizers.items():
            state = saved.optimizers[phase]["state"]
            # Learning rates and the like come from the configuration, not from the file.
            own_groups = optimizer.state_dict()["param_groups"]
            optimizer.load_state_dict({"state": state, "param_groups": own_groups})
        if self.average:
            self.average.network.load_state_dict(saved.ema_generator or {})
        if saved.precision:
            self.fabric.strategy.precision.load_state_dict(saved.precision)
        first = {"rng": saved.rng, "device_rng": saved.device_rng, "extra": saved.extra}
        own = [first, *saved.others][self.fabric.global_rank]
        load_process_state(self.method, self.fabric.device, own)


def _weights(optimizer: torch.optim.Optimizer) -> list[Tensor]:
    return [weight for group in optimizer.param_groups for weight in group["params"]]
