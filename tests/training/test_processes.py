"""What the processes of a run tell each other, by gloo; they are copies of the tests' own."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
import torch
from lightning_fabric import Fabric
from rooms import EFFICIENT, room_data
from runs import same

from depthcli.errors import CheckpointError
from depthcli.training.checkpoint import Checkpoint
from depthcli.training.devices import (
    AveragingStrategy,
    any_process,
    average_gradients,
    first_process_first,
    of_others,
)
from depthcli.training.finite import finite_losses
from depthcli.training.folder import CHECKPOINT, METRICS_LOG
from depthcli.training.loop import Limits, fit
from depthcli.training.run import Run
from depthcli.training.watchers import Watcher

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

CONFIG = replace(EFFICIENT, optim=replace(EFFICIENT.optim, batch_size=4))


def _in_two(work: Callable[[Fabric], Any], folder: Path) -> list[Any]:
    """What some work gives in each of two processes."""
    fabric = Fabric(accelerator="cpu", devices=2, strategy=AveragingStrategy(start_method="fork"))

    def each(fabric: Fabric) -> None:
        torch.save(work(fabric), folder / f"of-{fabric.global_rank}.pt")

    fabric.launch(each)
    return [torch.load(folder / f"of-{rank}.pt", weights_only=False) for rank in (0, 1)]


def test_gradients_losses_votes_and_states_are_exchanged(tmp_path: Path) -> None:
    def work(fabric: Fabric) -> Any:
        rank = fabric.global_rank
        weights = [torch.nn.Parameter(torch.zeros(2, 3)), torch.nn.Parameter(torch.zeros(4))]
        weights[0].grad = torch.full((2, 3), 1.0 + 4 * rank)
        unused = torch.nn.Parameter(torch.zeros(1))
        average_gradients(fabric, [weights[0], unused])
        weights[1].grad = torch.arange(4.0) * (1 - 2 * rank)
        average_gradients(fabric, weights)
        with first_process_first(fabric):
            order = sorted(path.name for path in tmp_path.glob("been-*"))
            (tmp_path / f"been-{rank}").touch()
        return {
            "gradients": [weight.grad for weight in weights],
            "losses": finite_losses({"l1": torch.tensor(1.0 + rank)}, fabric),
            "votes": [any_process(fabric, said) for said in (False, rank == 1, True)],
            "others": of_others(fabric, {"rank": rank}),
            "order": order,
            "chance": (Run(CONFIG, fabric, 2).method.state_dict(), torch.rand(3)),
        }

    both = _in_two(work, tmp_path)
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
    assert of_others(fabric, {"rng": 1}) == []


def test_two_processes_learn_as_one_and_go_on_exactly(tmp_path: Path) -> None:
    """The same weights in both, chance of their own; the first one writes."""

    def work(fabric: Fabric) -> Any:
        notes = list[tuple[int, dict[str, float]]]()
        watcher = Watcher()
        watcher.step = lambda progress, _, losses: notes.append((progress.step, losses))  # type: ignore[method-assign]
        for out, limits in (("whole", (2,)), ("parts", (1, 1))):
            for steps in limits:
                fit(CONFIG, room_data(), tmp_path / out, fabric, watcher, Limits(steps=steps))
        return notes

    first, second = _in_two(work, tmp_path)
    assert [step for step, _ in first] == [1, 2, 1, 2]
    assert first[:2] == first[2:]
    assert second == []  # the first one alone tells
    whole, parts = (Checkpoint.load(tmp_path / out / CHECKPOINT) for out in ("whole", "parts"))
    for field in ("method", "average", "optimizers", "rng", "others"):
        assert same(getattr(whole, field), getattr(parts, field)), field
    assert len(whole.others) == 1
    assert not torch.equal(whole.rng, whole.others[0]["rng"])
    assert len((tmp_path / "parts" / METRICS_LOG).read_text().splitlines()) == 2
    alone = Fabric(accelerator="cpu", devices=1)
    with pytest.raises(CheckpointError, match="a run on 2 devices: give --devices 2"):
        fit(CONFIG, room_data(), tmp_path / "whole", alone, Watcher())
