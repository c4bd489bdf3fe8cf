"""Shell completion of the values of options and arguments, except file names."""

from collections.abc import Callable, Iterable
from importlib import import_module

# Importing onnxruntime is slow; a test compares these names with it.
_ACCELERATED = ("cuda", "tensorrt", "rocm", "migraphx", "directml", "coreml", "openvino")
PROVIDERS = ("auto", "cpu", *_ACCELERATED)
ACCELERATORS = ("auto", "cpu", "cuda", "mps")


def starting_with(words: Iterable[str], incomplete: str) -> list[str]:
    """The words that complete one."""
    return [word for word in words if word.startswith(incomplete)]


def _names_in(module: str, name: str) -> Callable[[str], list[str]]:
    """A completion by what a function or a collection of a module holds, imported when needed."""

    def complete(incomplete: str) -> list[str]:
        found = getattr(import_module(f"depthcli.{module}"), name)
        return starting_with(found() if callable(found) else found, incomplete)

    return complete


cards = _names_in("models.catalog", "ready_names")
presets = _names_in("lab.training.presets", "PRESETS")
methods = _names_in("lab.training.methods.table", "METHODS")
profiles = _names_in("cli.profiles", "profile_names")
providers = _names_in("cli.completion", "PROVIDERS")
accelerators = _names_in("cli.completion", "ACCELERATORS")


def models(incomplete: str) -> list[str]:
    """Names for ``--model``."""
    from depthcli.models.catalog import list_locations

    return starting_with((name for name, _ in list_locations()), incomplete)


def models_and_cards(incomplete: str) -> list[str]:
    """Names of models, and of ready cards."""
    return [*models(incomplete), *cards(incomplete)]
