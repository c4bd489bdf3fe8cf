"""The methods by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.errors import UsageError
from depthcli.training.methods.proposed import Proposed

if TYPE_CHECKING:
    from depthcli.training.config import TrainConfig
    from depthcli.training.methods.base import Method

METHODS: dict[str, type[Method]] = {"proposed": Proposed}


def build_method(config: TrainConfig) -> Method:
    """The method that a configuration names, with fresh weights.

    Raises:
        UsageError: there is no such method.
    """
    if config.method not in METHODS:
        raise UsageError(f"no method '{config.method}'; choose from {', '.join(METHODS)}")
    return METHODS[config.method](config)
