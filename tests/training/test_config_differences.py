"""What is named when a folder holds another run."""

from __future__ import annotations

from dataclasses import replace

from depthcli.training.checkpoint import RunProgress
from depthcli.training.config.schema import TrainConfig
from depthcli.training.config_differences import data_differences, differences

CONFIG = TrainConfig()
PROGRESS = RunProgress(train_ids=("a", "b"), extra="9 photos", start="default 1.1.0")


def test_each_setting_is_named_with_both_values() -> None:
    given = replace(CONFIG, seed=7, optim=replace(CONFIG.optim, batch_size=4))
    assert differences(CONFIG, CONFIG) == ()
    assert differences(CONFIG, given) == (
        f"seed is {CONFIG.seed} there, 7 here",
        f"optim.batch_size is {CONFIG.optim.batch_size} there, 4 here",
    )


def test_other_data_are_named() -> None:
    assert data_differences(PROGRESS, PROGRESS) == ()
    other = replace(PROGRESS, train_ids=("a",), extra="")
    assert data_differences(PROGRESS, other) == (
        "the data set is another one (2 pairs there, 1 here)",
        'extra is "9 photos" there, "" here',
    )


def test_the_weights_of_the_start_need_not_be_given_again() -> None:
    assert data_differences(PROGRESS, replace(PROGRESS, start="")) == ()
    (strange,) = data_differences(PROGRESS, replace(PROGRESS, start="fast 1.1.0"))
    assert strange == 'start is "default 1.1.0" there, "fast 1.1.0" here'
