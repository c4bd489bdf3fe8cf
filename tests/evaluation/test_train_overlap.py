"""What a card tells of the pairs that its model was trained on."""

from dataclasses import replace
from typing import Any

import pytest
from helpers.small_set import small_set

from depthcli.datasets.base import SplitName
from depthcli.evaluation.task import plan_nyu, plan_pairs, train_overlap, trained_numbers
from depthcli.models.card import ModelCard
from depthcli.models.catalog import ready_card


def card(training: dict[str, Any]) -> ModelCard:
    return replace(ready_card("fastdepth"), training=training)


@pytest.mark.parametrize(
    ("training", "expected"),
    [
        ({"nyu_train_ids": "0000-0002,0900"}, {0, 1, 2, 900}),
        ({"nyu_split": "official"}, {1, 3, 5, 7}),
        ({"nyu_split": "paper"}, set(range(8))),
        ({"nyu_train_ids": "all"}, None),
        ({"nyu_split": "eigen"}, None),
        ({}, None),
    ],
)
def test_trained_numbers_are_the_card_s(
    training: dict[str, Any], expected: set[int] | None
) -> None:
    """Scenes are pairs of neighbours; odd ones are the official training part."""
    assert trained_numbers(card(training), small_set(8)) == expected


def test_only_images_that_are_compared_count() -> None:
    task = plan_nyu(small_set(8), SplitName.OFFICIAL)  # 0, 2, 4, 6
    assert train_overlap(card({"nyu_train_ids": "0002-0004"}), task) == 2
    assert train_overlap(card({"nyu_train_ids": "0001"}), task) == 0
    assert train_overlap(card({}), task) is None
    own = plan_pairs(small_set(8), "own")
    assert train_overlap(card({"nyu_train_ids": "0002-0004"}), own) is None


@pytest.mark.parametrize("name", ["meter-nyu", "fastdepth"])
def test_ready_cards_of_nyu_name_its_official_split(name: str) -> None:
    assert trained_numbers(ready_card(name), small_set(4)) == {1, 3}
