"""The methods by name, and what each is set to."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.errors import UsageError
from depthcli.training.config.changes import updated
from depthcli.training.config.objective import TERMS
from depthcli.training.config.schema import TrainConfig
from depthcli.training.methods.cut import Cut
from depthcli.training.methods.cyclegan import CycleGan
from depthcli.training.methods.dclgan import DclGan
from depthcli.training.methods.hnegsrc import HnegSrc
from depthcli.training.methods.proposed import Proposed
from depthcli.training.methods.simdcl import SimDcl

if TYPE_CHECKING:
    from depthcli.training.methods.base import Method

METHODS: dict[str, type[Method]] = {
    "cyclegan": CycleGan,
    "cut": Cut,
    "fastcut": Cut,
    "dclgan": DclGan,
    "simdcl": SimDcl,
    "hnegsrc": HnegSrc,
    "proposed": Proposed,
}
"""In the order of the paper's Table I."""
_OF_SOME = sorted(frozenset().union(*(method.SETTINGS for method in METHODS.values())))
DEFAULTS = Path(__file__).parent / "defaults"


def default_config(method: str) -> TrainConfig:
    """A method as its authors set it: the differences from the paper's, which is the default.

    Raises:
        UsageError: there is no such method.
    """
    _known(method)
    differences = tomllib.loads((DEFAULTS / f"{method}.toml").read_text("utf-8"))
    return updated(TrainConfig(method=method), differences)


def build_method(config: TrainConfig) -> Method:
    """The method that a configuration names, with fresh weights.

    Raises:
        UsageError: there is no such method, or a setting would do nothing.
    """
    check_terms(config)
    return METHODS[config.method](config)


def check_terms(config: TrainConfig) -> None:
    """Accept a configuration whose losses and settings its method has.

    Raises:
        UsageError: otherwise; one that does nothing would be taken for one that does.
    """
    known = _known(config.method).TERMS
    strange = [name for name in TERMS if getattr(config.loss, name) and name not in known]
    if strange:
        raise UsageError(
            f"{config.method} has no loss.{strange[0]}; it has loss.{', loss.'.join(sorted(known))}"
        )
    if not any(getattr(config.loss, name) for name in known):
        raise UsageError(f"one of loss.{', loss.'.join(sorted(known))} is above 0")
    _check_settings(config)
    if config.data.paired and not METHODS[config.method].PAIRED:
        raise UsageError(f"{config.method} learns without pairs: remove data.paired")


def _check_settings(config: TrainConfig) -> None:
    known, usual = METHODS[config.method].SETTINGS, default_config(config.method)
    for path in _OF_SOME:
        if path not in known and _value(config, path) != _value(usual, path):
            raise UsageError(f"{config.method} does not use {path}: remove it")


def _value(config: TrainConfig, path: str) -> object:
    group, name = path.split(".")
    return getattr(getattr(config, group), name)


def _known(method: str) -> type[Method]:
    if method not in METHODS:
        raise UsageError(f"no method '{method}'; choose from {', '.join(METHODS)}")
    return METHODS[method]
