"""The class and the default configuration of each method."""

import tomllib
from pathlib import Path
from pkgutil import resolve_name

from depthcli.errors import UsageError
from depthcli.training.config import TERMS, TrainConfig
from depthcli.training.methods.base import Method
from depthcli.training.methods.table import METHODS, PRETRAINING
from depthcli.training.settings import updated

_ALL = METHODS | PRETRAINING

DEFAULTS = Path(__file__).parent / "defaults"


def method_class(name: str) -> type[Method]:
    """The class of a method; imports its module, and with it torch.

    Raises:
        UsageError: there is no such method.
    """
    if name not in _ALL:
        raise UsageError(f"no method '{name}'; choose from {', '.join(_ALL)}")
    found: type[Method] = resolve_name(f"depthcli.training.methods.{_ALL[name]}")
    return found


def default_config(method: str) -> TrainConfig:
    """The default configuration of a method.

    That of the paper's method without the losses and the pairing that this one does not support,
    overridden by its file in ``defaults/``.

    Raises:
        UsageError: there is no such method.
    """
    kind, file = method_class(method), DEFAULTS / f"{method}.toml"
    absent = {term: 0.0 for term in TERMS if term not in kind.TERMS}
    usual = {"loss": absent, "data": {"paired": kind.PAIRED}}
    config = updated(TrainConfig(method=method), usual)
    return updated(config, tomllib.loads(file.read_text("utf-8"))) if file.is_file() else config


def build_method(config: TrainConfig) -> Method:
    """The method of a configuration, newly initialized.

    Raises:
        UsageError: there is no such method, or a setting would have no effect.
    """
    check_terms(config)
    return method_class(config.method)(config)


def check_terms(config: TrainConfig) -> None:
    """Check that the method uses all losses and settings of the configuration.

    Raises:
        UsageError: one of them would have no effect.
    """
    method = method_class(config.method)
    supported = method.TERMS
    known = ", loss.".join(sorted(supported))
    unknown = [name for name in TERMS if getattr(config.loss, name) and name not in supported]
    if unknown:
        raise UsageError(f"{config.method} has no loss.{unknown[0]}; it has loss.{known}")
    if not any(getattr(config.loss, name) for name in supported):
        raise UsageError(f"set one of loss.{known} above 0")
    _check_settings(config, method.SETTINGS)
    if config.data.paired and not method.PAIRED:
        raise UsageError(f"{config.method} trains on unpaired data: remove data.paired")


def _check_settings(config: TrainConfig, supported: frozenset[str]) -> None:
    usual = default_config(config.method)
    for path in sorted(frozenset().union(*(method_class(name).SETTINGS for name in _ALL))):
        if path not in supported and _setting(config, path) != _setting(usual, path):
            raise UsageError(f"{config.method} does not use {path}: remove it")


def _setting(config: TrainConfig, path: str) -> object:
    group, name = path.split(".")
    return getattr(getattr(config, group), name)
