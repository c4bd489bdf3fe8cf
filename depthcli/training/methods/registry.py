"""A method's class, and what it is set to."""

import tomllib
from importlib import import_module
from pathlib import Path

from depthcli.errors import UsageError
from depthcli.training.config.changes import updated
from depthcli.training.config.objective import TERMS
from depthcli.training.config.schema import TrainConfig
from depthcli.training.methods.base import Method
from depthcli.training.methods.table import METHODS

DEFAULTS = Path(__file__).parent / "defaults"


def method_class(name: str) -> type[Method]:
    """The class of a method; its module, and with it torch, is loaded now.

    Raises:
        UsageError: there is no such method.
    """
    if name not in METHODS:
        raise UsageError(f"no method '{name}'; choose from {', '.join(METHODS)}")
    module, _, attribute = METHODS[name].partition(":")
    found: type[Method] = getattr(import_module(f"depthcli.training.methods.{module}"), attribute)
    return found


def default_config(method: str) -> TrainConfig:
    """A method as its authors set it.

    Unless its file of ``defaults/`` says otherwise, it is set as the paper's method, without the
    losses and the pairs that it does not know.

    Raises:
        UsageError: there is no such method.
    """
    kind, file = method_class(method), DEFAULTS / f"{method}.toml"
    absent = {term: 0.0 for term in TERMS if term not in kind.TERMS}
    usual = {"loss": absent, "data": {"paired": kind.PAIRED}}
    config = updated(TrainConfig(method=method), usual)
    return updated(config, tomllib.loads(file.read_text("utf-8"))) if file.is_file() else config


def build_method(config: TrainConfig) -> Method:
    """The method that a configuration names, with fresh weights.

    Raises:
        UsageError: there is no such method, or a setting would do nothing.
    """
    check_terms(config)
    return method_class(config.method)(config)


def check_terms(config: TrainConfig) -> None:
    """Accept a configuration whose losses and settings its method has.

    Raises:
        UsageError: otherwise; one that does nothing would be taken for one that does.
    """
    method = method_class(config.method)
    known = method.TERMS
    strange = [name for name in TERMS if getattr(config.loss, name) and name not in known]
    if strange:
        raise UsageError(
            f"{config.method} has no loss.{strange[0]}; it has loss.{', loss.'.join(sorted(known))}"
        )
    if not any(getattr(config.loss, name) for name in known):
        raise UsageError(f"one of loss.{', loss.'.join(sorted(known))} is above 0")
    _check_settings(config, method.SETTINGS)
    if config.data.paired and not method.PAIRED:
        raise UsageError(f"{config.method} learns without pairs: remove data.paired")


def _check_settings(config: TrainConfig, known: frozenset[str]) -> None:
    usual = default_config(config.method)
    for path in sorted(frozenset().union(*(method_class(name).SETTINGS for name in METHODS))):
        if path not in known and _setting(config, path) != _setting(usual, path):
            raise UsageError(f"{config.method} does not use {path}: remove it")


def _setting(config: TrainConfig, path: str) -> object:
    group, name = path.split(".")
    return getattr(getattr(config, group), name)
