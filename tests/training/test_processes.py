"""What the processes of a run tell each other, by gloo; each is a Python of its own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.rooms import EFFICIENT, room_data
from helpers.runs import same
from lightning_fabric import Fabric

from depthcli.errors import CheckpointError
from depthcli.training.callbacks import Callback
from depthcli.training.checkpoint import CHECKPOINT, METRICS_LOG, Checkpoint
from depthcli.training.devices import (
    AveragingStrategy,
    any_process,
    average_gradients,
    gather_states,
    rank_zero_first,
)
from depthcli.training.run import Run, finite_losses, fit

CONFIG = replace(EFFICIENT, optim=replace(EFFICIENT.optim, batch_size=4))


def _each(fabric: Fabric, folder: Path) -> None:
    """What one of two processes does and keeps."""
    found = _exchange(fabric, folder), _learn(fabric, folder)
    torch.save(found, folder / f"of-{fabric.global_rank}.pt")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What two processes left; spawned, for a fork would wait for locks of this one's threads."""
    folder = tmp_path_factory.mktemp("two")
    fabric = Fabric(accelerator="cpu", devices=2, strategy=AveragingStrategy(start_method="spawn"))
    fabric.launch(_each, folder)
    return folder


def _kept(folder: Path, which: int) -> list[Any]:
    """What both processes found."""
    return [torch.load(folder / f"of-{n}.pt", weights_only=False)[which] for n in (0, 1)]


def _exchange(fabric: Fabric, folder: Path) -> dict[str, Any]:
    rank = fabric.global_rank
    weights = [torch.nn.Parameter(torch.zeros(2, 3)), torch.nn.Parameter(torch.zeros(4))]
    weights[0].grad = torch.full((2, 3), 1.0 + 4 * rank)
    unused = torch.nn.Parameter(torch.zeros(1))
    average_gradients(fabric, [weights[0], unused])
    weights[1].grad = torch.arange(4.0) * (1 - 2 * rank)
    average_gradients(fabric, weights)
    with rank_zero_first(fabric):
        order = sorted(path.name for path in folder.glob("been-*"))
        (folder / f"been-{rank}").touch()
    return {
        "gradients": [weight.grad for weight in weights],
        "losses": finite_losses({"l1": torch.tensor(1.0 + rank)}, fabric),
        "votes": [any_process(fabric, said) for said in (False, rank == 1, True)],
        "others": gather_states(fabric, {"rank": rank}),
        "order": order,
        "chance": (Run(CONFIG, fabric, 2).method.state_dict(), torch.rand(3)),
    }


def test_gradients_losses_votes_and_states_are_exchanged(folder: Path) -> None:
    both = _kept(folder, 0)
    for rank, found in enumerate(both):
        assert same(found["gradients"], [torch.full((2, 3), 3.0), torch.zeros(4)])
        assert found["losses"] == {"l1": 1.5}
        assert found["votes"] == [False, True, True]
        assert found["others"] == [{"rank": 1}]
        assert found["order"] == ["been-0"][:rank]
    (weights, _), (same_weights, of_second) = (found["chance"] for found in both)
    assert same(weights, same_weights)
    seeded = torch.Generator().manual_seed(CONFIG.seed + 1_000_003)  # as in every version
    assert torch.equal(of_second, torch.rand(3, generator=seeded))


def test_one_process_keeps_all_as_it_is() -> None:
    fabric, weight = Fabric(accelerator="cpu", devices=1), torch.nn.Parameter(torch.zeros(2))
    weight.grad = torch.ones(2)
    average_gradients(fabric, [weight])
    assert torch.equal(weight.grad, torch.ones(2))
    assert [any_process(fabric, said) for said in (False, True)] == [False, True]
    assert gather_states(fabric, {"rng": 1}) == []


def _learn(fabric: Fabric, folder: Path) -> list[tuple[int, dict[str, float]]]:
    notes = list[tuple[int, dict[str, float]]]()
    callback = Callback()
    callback.on_step_end = lambda state, _, losses: notes.append((state.step, losses))  # type: ignore[method-assign]
    for out, limits in (("whole", (2,)), ("parts", (1, 1))):
        for steps in limits:
            fit(CONFIG, room_data(), folder / out, fabric, callback, max_steps=steps)
    return notes


def test_two_processes_learn_as_one_and_go_on_exactly(folder: Path) -> None:
    """The same weights in both, chance of their own; the first one writes."""
    first, second = _kept(folder, 1)
    assert [step for step, _ in first] == [1, 2, 1, 2]
    assert first[:2] == first[2:]
    assert second == []  # the first one alone tells
    whole, parts = (Checkpoint.load(folder / out / CHECKPOINT) for out in ("whole", "parts"))
    for field in ("method", "ema_generator", "optimizers", "rng", "others"):
        assert same(getattr(whole, field), getattr(parts, field)), field
    assert len(whole.others) == 1
    assert not torch.equal(whole.rng, whole.others[0]["rng"])
    assert len((folder / "parts" / METRICS_LOG).read_text().splitlines()) == 2
    alone = Fabric(accelerator="cpu", devices=1)
    with pytest.raises(CheckpointError):
        fit(CONFIG, room_data(), folder / "whole", alone, Callback())
