"""The class and the default configuration of each method."""

import tomllib
from pathlib import Path
from pkgutil import resolve_name

from depthcli.core.options import suggestion
from depthcli.errors import UsageError
from depthcli.lab.training.config import TERMS, TrainConfig, updated
from depthcli.lab.training.methods.base import Method
from depthcli.lab.training.methods.table import METHODS
from depthcli.lab.training.plugins import imported

DEFAULTS = Path(__file__).parent / "defaults"


def method_class(name: str) -> type[Method]:
    """The class of a method of the table, or of ``module:Class``; imports its module, and torch."""
    if name in METHODS:
        return resolve_name(f"depthcli.lab.training.methods.{METHODS[name]}")  # type: ignore[no-any-return]
    kind = imported(name) if ":" in name else None
    if not (isinstance(kind, type) and issubclass(kind, Method)):
        advice = f"choose from {', '.join(METHODS)}, or name a subclass of Method as module:Class"
        raise UsageError(f"no method '{name}'", suggestion(name, METHODS, advice))
    return kind


def default_config(method: str) -> TrainConfig:
    """The paper's method without what this one does not support, overridden by a file."""
    kind, file = method_class(method), DEFAULTS / f"{method}.toml"
    absent = {term: 0.0 for term in TERMS if term not in kind.TERMS}
    usual = {"loss": absent, "data": {"paired": kind.PAIRED}}
    config = updated(TrainConfig(method=method), usual)
    return updated(config, tomllib.loads(file.read_text("utf-8"))) if file.is_file() else config


def build_method(config: TrainConfig) -> Method:
    """The method of a configuration, newly initialized."""
    check_terms(config)
    return method_class(config.method)(config)


def check_terms(config: TrainConfig) -> None:
    """Check that the method uses all losses of the configuration."""
    method = method_class(config.method)
    supported = ", loss.".join(sorted(method.TERMS))
    weights = {name: getattr(config.loss, name) for name in (*TERMS, "custom")}
    unknown = [name for name, weight in weights.items() if weight and name not in method.TERMS]
    if unknown:
        raise UsageError(f"{config.method} has no loss.{unknown[0]}; it has loss.{supported}")
    if not any(weights.values()):
        raise UsageError(f"set one of loss.{supported} above 0")
    if config.data.paired and not method.PAIRED:
        raise UsageError(f"{config.method} trains on unpaired data: remove data.paired")
