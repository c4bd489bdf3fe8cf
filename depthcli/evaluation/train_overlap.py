"""Overlap of the evaluated pairs of NYU Depth v2 with those that a model was trained on."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from depthcli.datasets import id_ranges
from depthcli.datasets.base import DepthDataset
from depthcli.datasets.splits import (
    NYU,
    TRAIN_IDS,
    SplitName,
    held_out_scenes,
    train_positions,
)
from depthcli.errors import DatasetError
from depthcli.models.card import ModelCard

TRAIN_SPLIT = "nyu_split"
"""Field of a third-party model's card: the split whose training scenes it was trained on."""


def train_overlap(predictor: object, dataset: DepthDataset, ids: Iterable[str]) -> int | None:
    """Number of images that a predictor was trained on; None if unknown."""
    card = getattr(predictor, "card", None)  # only models have one
    numbers = trained_numbers(card, dataset) if isinstance(card, ModelCard) else None
    return None if numbers is None else sum(int(name) in numbers for name in ids)


def trained_numbers(card: ModelCard, dataset: DepthDataset) -> frozenset[int] | None:
    """Numbers of the pairs that a model was trained on, or whose scenes it was trained on.

    None if its card does not state them; the data set has the training pairs of a split.
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
            return _numeric_ids(
                dataset, _config_train_positions(card.training["config"]["data"], dataset)
            )
    except (DatasetError, KeyError, TypeError, ValueError):
        return None  # ``training`` in a card is free-form
    return None


def _config_train_positions(data: Mapping[str, Any], dataset: DepthDataset) -> Sequence[int]:
    """Training pairs of ``depthcli train`` by its settings; cards of 0.1.0 state only these."""
    rows = train_positions(dataset, SplitName(data["split"]))
    if not data["holdout_every"]:
        return rows
    scenes = [dataset.scenes[i] for i in rows]
    held_out = held_out_scenes(scenes, data["holdout_every"], data["holdout_offset"])
    return [i for i in rows if dataset.scenes[i] not in held_out]


def _numeric_ids(dataset: DepthDataset, rows: Iterable[int]) -> frozenset[int]:
    return frozenset(int(dataset.ids[i]) for i in rows)
