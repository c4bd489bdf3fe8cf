"""Which pairs of NYU Depth v2 a model has learned, by its card: on those its scores say little."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from depthcli.datasets import id_ranges
from depthcli.datasets.base import DepthDataset
from depthcli.datasets.splits import NYU, SplitName, held_out_scenes, train_positions
from depthcli.errors import DatasetError
from depthcli.models.card import ModelCard

TRAIN_IDS = "nyu_train_ids"
"""Field of a card's ``training``: ids of the pairs, as :mod:`~depthcli.datasets.id_ranges`."""
TRAIN_SPLIT = "nyu_split"
"""The same for a model of others: the split whose training scenes it learned."""


@runtime_checkable
class HasCard(Protocol):
    """A predictor that is a model."""

    @property
    def card(self) -> ModelCard:
        """Its card."""
        ...


def learned_count(predictor: object, dataset: DepthDataset, ids: Iterable[str]) -> int | None:
    """How many of a data set's images a predictor has learned; None where nothing tells."""
    if not isinstance(predictor, HasCard):
        return None
    numbers = learned_numbers(predictor.card, dataset)
    if numbers is None:
        return None
    return sum(int(name) in numbers for name in ids)


def learned_numbers(card: ModelCard, dataset: DepthDataset) -> frozenset[int] | None:
    """Label numbers of the pairs that a model has learned, or whose scenes it has.

    None where the card says nothing of it; the data set tells which pairs a split's training has.
    """
    stated = card.training.get(TRAIN_IDS)
    if isinstance(stated, str):
        try:
            return id_ranges.parse(stated)
        except ValueError:
            return None
    split = card.training.get(TRAIN_SPLIT)
    try:
        if isinstance(split, str):
            return _numeric_ids(dataset, train_positions(dataset, SplitName(split)))
        if str(card.training.get("data", "")).startswith(NYU):
            return _numeric_ids(dataset, _of_config(card.training["config"]["data"], dataset))
    except (DatasetError, KeyError, TypeError, ValueError):
        return None  # a card's training is free text: what cannot be read tells nothing
    return None


def _of_config(data: Mapping[str, Any], dataset: DepthDataset) -> Sequence[int]:
    """What a run of ``depthcli train`` learned: cards of version 0.1.0 have its settings alone."""
    rows = train_positions(dataset, SplitName(data["split"]))
    if not data["holdout_every"]:
        return rows
    scenes = [dataset.scenes[i] for i in rows]
    held_out = held_out_scenes(scenes, data["holdout_every"], data["holdout_offset"])
    return [i for i in rows if dataset.scenes[i] not in held_out]


def _numeric_ids(dataset: DepthDataset, rows: Iterable[int]) -> frozenset[int]:
    return frozenset(int(dataset.ids[i]) for i in rows)
