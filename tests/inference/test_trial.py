"""Trial runs of models."""

from contextlib import nullcontext
from pathlib import Path

import pytest
from helpers.tiny import fixed_inside, write_model

from depthcli.errors import DepthcliError, InputError, ModelError
from depthcli.inference.pipeline import check_network
from depthcli.inference.session import Session
from depthcli.models.catalog import find_model

ERROR = ModelError("no depth of a.png")


def session(folder: Path, height: int) -> Session:
    """Of a network that runs on inputs of one height only; its card states 12."""
    return Session(find_model(write_model(folder / "model", fixed_inside(height))), provider="cpu")


@pytest.mark.parametrize(
    ("error", "height", "is_raised"),
    [(ERROR, 12, False), (ERROR, 13, True), (InputError("a.png is empty"), 13, False)],
)
def test_only_an_error_of_a_network_that_never_works_is_raised_again(
    tmp_path: Path, error: DepthcliError, height: int, is_raised: bool
) -> None:
    with pytest.raises(ModelError) if is_raised else nullcontext() as caught:
        check_network(error, session(tmp_path, height))
    assert not is_raised or caught.value is error
