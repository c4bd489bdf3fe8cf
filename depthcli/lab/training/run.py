"""One run: networks, optimizers and weight average; the training loop, saving and resuming."""

import copy
import logging
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from lightning_fabric import Fabric
from lightning_fabric.utilities.exceptions import MisconfigurationException
from torch import Tensor, nn
from torch.optim import Optimizer

from depthcli.core.parallel import Interrupt, usable_cores
from depthcli.errors import CheckpointError, TrainingError, UsageError
from depthcli.lab.datasets.training_data import TrainingData
from depthcli.lab.training import callbacks, checkpoint, provenance
from depthcli.lab.training.checkpoint import Checkpoint, write_errors
from depthcli.lab.training.config import OptimConfig, Precision, TrainConfig
from depthcli.lab.training.data import Batches, PairStore, TrainingBatch
from depthcli.lab.training.init_weights import load_init_weights
from depthcli.lab.training.methods.base import Method, Phase
from depthcli.lab.training.methods.registry import build_method
from depthcli.lab.training.networks.encoder import EncoderGenerator
from depthcli.lab.training.provenance import TrainState

_ACCELERATORS = {"cuda": torch.cuda, "mps": torch.mps}
_ADVICE = (
    "lower optim.learning_rate or use precision=32-true, and go on from the last checkpoint, "
    "which is kept"
)


def open_fabric(accelerator: str, precision: Precision) -> Fabric:
    """Device and precision of a run."""
    logging.getLogger("lightning_fabric").setLevel(logging.ERROR)  # it would log under --quiet
    try:
        return Fabric(accelerator=accelerator, devices=1, precision=precision)
    except (ImportError, MisconfigurationException, RuntimeError, ValueError) as error:
        message = f"cannot train on {accelerator} with precision={precision} here: {error}"
        raise UsageError(message) from error


def set_threads(count: int | None, folder: Path) -> None:
    """Set torch's CPU threads: the number given, else the checkpoint's, for equal last digits."""
    saved = checkpoint.saved_checkpoint(folder) if count is None else None
    if saved is not None:
        count = min(usable_cores(), saved.state.threads)
    torch.set_num_threads(count or usable_cores())


class Run:
    """Networks, optimizers and weight average of a run of ``steps``, which is in ``state``."""

    optimizers: dict[Phase, Optimizer]

    def __init__(self, config: TrainConfig, fabric: Fabric, steps_per_epoch: int) -> None:
        fabric.seed_everything(config.seed, verbose=False)
        self.config, self.fabric, self.steps_per_epoch = config, fabric, steps_per_epoch
        self.steps = config.optim.epochs * steps_per_epoch
        self.state, self.provenance = TrainState(), provenance.DataProvenance()
        self.method = build_method(config)
        # CPUs are 1.3 times as fast with channels last. On an H200, a pretrained encoder did not
        # do 14 steps in 40 s so; contiguous, with cudnn.benchmark, a step took .14 s.
        layout = torch.contiguous_format if fabric.device.type == "cuda" else torch.channels_last
        self.method.to(memory_format=layout)  # type: ignore[call-overload]
        phases = [phase for phase in self.method.phases if self.method.networks(phase)]
        optimizers = [build_optimizer(self.method, phase, config.optim) for phase in phases]
        rates = [[group["lr"] for group in o.param_groups] for o in optimizers]
        self.rates = dict(zip(phases, rates, strict=True))
        self.module, *ready = fabric.setup(self.method, *optimizers)
        self.optimizers = dict(zip(phases, ready, strict=True))
        decay = config.optim.ema
        self.average = WeightAverage(self.method.generator, decay) if decay else None

    @property
    def ema_generator(self) -> nn.Module:
        """The network that is validated: the weight average, if there is one."""
        return self.average.network if self.average else self.method.generator

    def step(self, batch: TrainingBatch) -> dict[str, float]:
        """One optimization step of every phase; the loss terms by name."""
        self.method.share_done = self.state.step / self.steps
        losses: dict[str, Tensor] = {}
        parts = batch.parts(self.config.optim.accumulate)
        for optimizer in self.optimizers.values():
            optimizer.zero_grad()
        for part in parts:
            share = len(part.network_input) / len(batch.network_input)
            for phase in self.optimizers:
                terms: dict[str, Tensor] = self.module(part, phase)
                for name, term in terms.items():
                    losses[name] = share * term.detach() + losses.get(name, 0.0)
                self.fabric.backward(share * torch.stack(list(terms.values())).sum())
                if part is parts[-1]:
                    self._update(phase)
        if self.average:
            self.average.update(self.method.generator, self.state.step + 1)
        together = torch.stack([loss.float() for loss in losses.values()])  # one transfer
        values = dict(zip(losses, together.tolist(), strict=True))
        for name, value in values.items():
            if not math.isfinite(value):
                raise TrainingError(f"the loss term '{name}' became {value}", _ADVICE)
        return values

    def _update(self, phase: Phase) -> None:
        optimizer, optim = self.optimizers[phase], self.config.optim
        factor = optim.lr_factor(self.state.step, self.steps_per_epoch)
        for group, rate in zip(optimizer.param_groups, self.rates[phase], strict=True):
            group["lr"] = factor * rate
        if optim.clip_norm and phase == "generator":
            # A loss that is not finite is an error of the step, which names it; the scaler of
            # half precision skips steps whose gradients alone are not.
            clip = partial(self.fabric.clip_gradients, max_norm=optim.clip_norm)
            clip(self.module, optimizer, error_if_nonfinite=False)
        optimizer.step()

    def save(self, path: Path) -> None:
        """Write a checkpoint."""
        self.check_weights()
        Checkpoint(
            config=self.config,
            state=self.state,
            provenance=self.provenance,
            method=self.method.state_dict(),
            ema_generator=self.average.network.state_dict() if self.average else None,
            optimizers={phase: o.state_dict() for phase, o in self.optimizers.items()},
            precision=self.fabric.strategy.precision.state_dict(),
            **random_state(self.method, self.fabric.device),
        ).save(path)

    def doubts(self, title: str) -> Iterator[str]:
        """Warnings about the held-out pairs, of the data set of this name."""
        held_out, init_ids = self.provenance.held_out_ids, self.provenance.init_ids
        if self.config.data.holdout_every and not held_out:
            yield "too few scenes to hold one out, so nothing is validated"
        if common := provenance.common_ids(title, held_out, init_ids):
            message = f"the init weights were trained on {len(common)} of the held-out pairs"
            yield f"{message}, so the scores are not those of new images"

    def check_weights(self) -> None:
        """Check weights before they are saved: a finite loss can have a gradient that is not."""
        for name, network in self.method.named_children():
            finite = [weight.isfinite().all() for weight in network.state_dict().values()]
            if finite and not bool(torch.stack(finite).all()):
                problem = f"a weight of '{name}' is not finite after step {self.state.step}"
                raise TrainingError(problem, _ADVICE)

    def resume(self, path: Path) -> None:
        """Restore the state of a checkpoint, if there is one."""
        if not path.exists():
            return
        saved = Checkpoint.load(path)
        mismatches = provenance.config_differences(saved.config, self.config)
        mismatches += provenance.data_differences(saved.provenance, self.provenance)
        if mismatches:
            raise provenance.mismatch_error(path, mismatches)
        try:
            self._load(saved)
        except (LookupError, RuntimeError, TypeError, ValueError) as error:
            message = f"{path} does not fit the networks of its own configuration"
            raise CheckpointError(message, "give another {out}") from error
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
        load_random_state(self.method, self.fabric.device, saved)


class WeightAverage:
    """Exponential moving average (EMA) of a network's weights, in ``network``, to evaluate.

    Each update keeps the fraction ``decay``, less in the first steps, so that the random initial
    weights count little.
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
    heads = [network for network in networks if network in heads]
    encoders = [network.encoder for network in networks if isinstance(network, EncoderGenerator)]
    apart = {*_weights(heads), *_weights(encoders)}
    body = [weight for weight in _weights(networks) if weight not in apart]
    of_encoder = {"lr": optim.learning_rate * optim.encoder_rate}
    of_head = {"lr": optim.head_learning_rate, "betas": (optim.head_beta1, optim.head_beta2)}
    groups: list[dict[str, Any]] = []
    for part, options in ((body, {}), (_weights(encoders), of_encoder), (_weights(heads), of_head)):
        kernels = [weight for weight in part if weight.ndim > 1]  # and matrices, which decay
        others = [weight for weight in part if weight.ndim <= 1]
        groups.append({"params": kernels, "weight_decay": optim.weight_decay, **options})
        groups.append({"params": others, "weight_decay": 0.0, **options})
    groups = [group for group in groups if group["params"]]
    return torch.optim.AdamW(groups, optim.learning_rate, (optim.beta1, optim.beta2))


def _weights(networks: Sequence[nn.Module]) -> list[Tensor]:
    return [weight for network in networks for weight in network.parameters()]


def random_state(method: Method, device: torch.device) -> dict[str, Any]:
    """Generators of random numbers and what they chose, on the CPU, by the checkpoint's keys."""
    accelerator, extra = _ACCELERATORS.get(device.type), method.extra_state()
    return {
        "rng": torch.get_rng_state(),
        "device_rng": accelerator.get_rng_state(device) if accelerator else None,
        "extra": {name: [image.cpu() for image in images] for name, images in extra.items()},
    }


def load_random_state(method: Method, device: torch.device, saved: Checkpoint) -> None:
    """Restore a state of :func:`random_state`."""
    extra = saved.extra.items()
    method.load_extra_state(
        {name: [image.to(device) for image in images] for name, images in extra}
    )
    torch.set_rng_state(saved.rng)
    accelerator, state = _ACCELERATORS.get(device.type), saved.device_rng
    # The states of different kinds of accelerators, between which a run can move, differ in size.
    if accelerator and state is not None and len(state) == len(accelerator.get_rng_state(device)):
        accelerator.set_rng_state(state, device)


def fit(
    config: TrainConfig,
    data: TrainingData,
    folder: Path,
    fabric: Fabric,
    *followers: callbacks.Callback,
    init_weights: Sequence[Path] = (),
    max_minutes: float = math.inf,
    max_steps: float = math.inf,
    interrupt: Interrupt | None = None,
) -> TrainState:
    """Train until the schedule, a limit or a signal ends it; resume from the folder's checkpoint.

    The folder receives checkpoint, metrics log and sample images. A new run starts from the mean of
    the init weights. After ``max_minutes``, ``max_steps`` or a signal, it saves and ends.
    """
    interrupt = interrupt or Interrupt()
    run, batches, validation = _set_up(config, data, folder, fabric, init_weights)
    for follower in followers:
        follower.on_train_start((*data.warnings, *run.doubts(data.title)))
    started, before = time.monotonic(), run.state
    with interrupt:
        while run.state.step < run.steps and not run.state.has_stalled(config.patience):
            losses = run.step(batches[run.state.step])
            step, elapsed_s = run.state.step + 1, time.monotonic() - started
            seconds = before.seconds + elapsed_s
            run.state = replace(run.state, step=step, seconds=seconds, scores={})
            for follower in followers:
                follower.on_step_end(run.state, run.steps, losses)
            epoch_ends = step % batches.steps_per_epoch == 0
            if epoch_ends:
                _end_epoch(run, validation, folder, losses)
            over = elapsed_s >= 60 * max_minutes or step - before.step >= max_steps
            stops = over or run.state.has_stalled(config.patience) or interrupt.number is not None
            due = epoch_ends and run.state.epoch % config.save_every == 0
            if due or stops or step == run.steps:
                run.save(folder / checkpoint.CHECKPOINT)
            for follower in followers if epoch_ends else ():
                follower.on_epoch_end(run.state)
            if stops:
                break
    return run.state


def _end_epoch(
    run: Run, validation: callbacks.Validation | None, folder: Path, losses: dict[str, float]
) -> None:
    run.check_weights()
    epoch = run.state.epoch + 1
    run.state = replace(run.state, epoch=epoch)
    due = epoch % run.config.validate_every == 0 or run.state.step == run.steps
    if validation and due:
        scores = validation.score(run.ema_generator, run.fabric.device)
        run.state = run.state.scored(scores, run.config.monitor)
        with write_errors(folder):
            callbacks.write_samples(folder, epoch, validation, run.ema_generator, run.fabric)
    with write_errors(folder):
        callbacks.append_log(folder / checkpoint.METRICS_LOG, run.state, losses)
    if run.state.best_epoch == epoch:
        run.save(folder / checkpoint.BEST_CHECKPOINT)


def _set_up(
    config: TrainConfig,
    data: TrainingData,
    folder: Path,
    fabric: Fabric,
    init_weights: Sequence[Path],
) -> tuple[Run, Batches, callbacks.Validation | None]:
    """Read the pairs, build the networks, and load the folder's checkpoint if there is one."""
    dataset, labels, device = data.dataset, data.pseudo_labels, fabric.device
    train_rows, held_out = provenance.train_val_split(dataset, config.data)
    origin = provenance.provenance_of(config, data)
    if config.patience and not held_out:
        raise UsageError("patience needs held-out pairs, and there are none: set patience=0")
    if labels is not None and (config.output.coding != "log" or config.method != "proposed"):
        raise UsageError("pseudo labels need the method proposed and output.coding=log")
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    store = PairStore(dataset, train_rows, config.data).to(device)
    label_store = None
    if labels is not None:
        label_store = PairStore(labels, range(len(labels)), config.data).to(device)
    batches = Batches(store, config, device, label_store)
    validation = callbacks.Validation(dataset, held_out, config) if held_out else None
    run = Run(config, fabric, batches.steps_per_epoch)
    run.provenance = origin
    if init_weights:
        run.provenance = load_init_weights(run.method.generator, init_weights, origin)
        if run.average:
            run.average = WeightAverage(run.method.generator, config.optim.ema)
    run.resume(folder / checkpoint.CHECKPOINT)
    run.state = replace(run.state, threads=torch.get_num_threads())
    with write_errors(folder):
        callbacks.truncate_log(folder / checkpoint.METRICS_LOG, run.state.step)
    return run, batches, validation
