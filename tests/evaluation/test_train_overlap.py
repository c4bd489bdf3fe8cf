"""What a card tells of the pairs that its model was trained on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import pytest
from small_set import Playback, small_set

from depthcli.datasets.splits import SplitName
from depthcli.evaluation.table import plan_nyu
from depthcli.evaluation.train_overlap import train_overlap, trained_numbers
from depthcli.models.ready_cards import ready_card

if TYPE_CHECKING:
    from depthcli.models.card import ModelCard

CONFIG = {"data": {"split": "paper", "holdout_every": 2, "holdout_offset": 1}}


def card(training: dict[str, Any]) -> ModelCard:
    return replace(ready_card("fastdepth"), training=training)


@pytest.mark.parametrize(
    ("training", "expected"),
    [
        ({"nyu_train_ids": "0000-0002,0900"}, {0, 1, 2, 900}),
        ({"nyu_split": "official"}, {1, 3, 5, 7}),
        ({"nyu_split": "paper"}, set(range(8))),
        ({"data": "NYU Depth v2, labelled pairs 1-1000", "config": CONFIG}, {0, 1, 4, 5}),
        ({"data": "own pairs (rooms)", "config": CONFIG}, None),
        ({"data": "NYU Depth v2, labelled pairs 1-1000"}, None),
        ({"nyu_train_ids": "all"}, None),
        ({"nyu_split": "eigen"}, None),
        ({}, None),
    ],
)
def test_what_a_card_tells(training: dict[str, Any], expected: set[int] | None) -> None:
    """Scenes are pairs of neighbours; odd ones are the official training part."""
    assert trained_numbers(card(training), small_set(8)) == expected


def test_without_a_hold_out_all_of_the_split_was_learned() -> None:
    config = {"data": {"split": "official", "holdout_every": 0, "holdout_offset": 0}}
    training = {"data": "NYU Depth v2, the official split's training pairs", "config": config}
    assert trained_numbers(card(training), small_set(6)) == {1, 3, 5}


@dataclass
class Known(Playback):
    """Files of a model whose card is known."""

    card: ModelCard | None = None


def test_only_images_that_are_compared_count() -> None:
    def known(ids: str) -> Known:
        return Known({}, card=card({"nyu_train_ids": ids}))

    task = plan_nyu(small_set(8), SplitName.OFFICIAL)  # 0, 2, 4, 6
    assert train_overlap(known("0002-0004"), task.dataset, task.ids) == 2
    assert train_overlap(known("0001"), task.dataset, task.ids) == 0
    assert train_overlap(Playback({}), task.dataset, task.ids) is None


@pytest.mark.parametrize("name", ["meter-nyu", "fastdepth"])
def test_ready_cards_of_nyu_name_its_official_split(name: str) -> None:
    assert trained_numbers(ready_card(name), small_set(4)) == {1, 3}
