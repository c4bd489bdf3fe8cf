"""Trial runs of models."""

from pathlib import Path

import pytest
from helpers.tiny import fixed_inside, write_model

from depthcli.errors import InputError, ModelError
from depthcli.inference.pipeline import check_network
from depthcli.inference.session import Session
from depthcli.models.catalog import find_model

ERROR = ModelError("no depth of a.png")


def session(folder: Path, height: int) -> Session:
    """Of a network that runs on inputs of one height only; its card states 12."""
    return Session(find_model(write_model(folder / "model", fixed_inside(height))), provider="cpu")


def test_a_network_that_works_may_fail_on_an_input(tmp_path: Path) -> None:
    check_network(ERROR, session(tmp_path, 12))


def test_the_first_error_is_that_of_a_network_that_never_works(tmp_path: Path) -> None:
    with pytest.raises(ModelError) as caught:
        check_network(ERROR, session(tmp_path, 13))
    assert caught.value is ERROR


def test_errors_of_the_input_need_no_trial(tmp_path: Path) -> None:
    check_network(InputError("a.png is empty"), session(tmp_path, 13))
