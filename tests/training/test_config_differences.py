"""What is named when a folder holds another run."""

from __future__ import annotations

from dataclasses import replace

from depthcli.training.checkpoint import TrainState
from depthcli.training.config import TrainConfig
from depthcli.training.provenance import data_differences, differences, source_differences

CONFIG = TrainConfig()
PROGRESS = TrainState(train_ids=("a", "b"), extra="9 photos", start="default 1.1.0")


def test_each_setting_is_named_with_both_values() -> None:
    given = replace(CONFIG, seed=7, optim=replace(CONFIG.optim, batch_size=4))
    assert differences(CONFIG, CONFIG) == ()
    assert differences(CONFIG, given) == (
        f"seed is {CONFIG.seed} there, 7 here",
        f"optim.batch_size is {CONFIG.optim.batch_size} there, 4 here",
    )


def test_other_data_are_named() -> None:
    assert data_differences(PROGRESS, PROGRESS) == ()
    other = replace(PROGRESS, train_ids=("a",), held_out_ids=("b",), aspect=2.0, extra="")
    assert data_differences(PROGRESS, other) == (
        "the data set is another one (2 pairs and 0 held out there, 1 pairs and 1 held out here)",
        "aspect is 1.3333333333333333 there, 2.0 here",
    )
    assert source_differences(PROGRESS, other) == ('extra is "9 photos" there, "" here',)


def test_content_is_compared_instead_of_names_if_both_are_known() -> None:
    known = replace(PROGRESS, fingerprints=("1", "2"))
    renamed = replace(known, data="own pairs (mine)")
    assert data_differences(known, renamed) == ()
    assert len(data_differences(PROGRESS, renamed)) == 1
    for other in (replace(known, fingerprints=("3", "2")), replace(known, fingerprints=("1", "3"))):
        found = (*data_differences(known, other), *source_differences(known, other))
        assert len(found) == 1
    assert source_differences(PROGRESS, known) == ()


def test_the_weights_of_the_start_need_not_be_given_again() -> None:
    assert source_differences(PROGRESS, replace(PROGRESS, start="")) == ()
    (strange,) = source_differences(PROGRESS, replace(PROGRESS, start="fast 1.1.0"))
    assert strange == 'start is "default 1.1.0" there, "fast 1.1.0" here'
