"""Shell completion of the values of options and arguments, except file names."""

from collections.abc import Callable, Iterable
from importlib import import_module

# Importing onnxruntime is slow; a test compares these names with it.
_ACCELERATED = ("cuda", "tensorrt", "rocm", "migraphx", "directml", "coreml", "openvino")
PROVIDERS = ("auto", "cpu", *_ACCELERATED)


def starting_with(words: Iterable[str], incomplete: str) -> list[str]:
    """The words that complete one."""
    return [word for word in words if word.startswith(incomplete)]


def offered(words: Iterable[str]) -> Callable[[str], list[str]]:
    """A completion by some words."""

    def complete(incomplete: str) -> list[str]:
        return starting_with(words, incomplete)

    return complete


def _names_in(module: str, name: str) -> Callable[[str], list[str]]:
    """A completion by what a function of a module returns, which is imported when needed."""

    def complete(incomplete: str) -> list[str]:
        return starting_with(getattr(import_module(f"depthcli.{module}"), name)(), incomplete)

    return complete


cards = _names_in("models.catalog", "ready_names")
profiles = _names_in("cli.profiles", "profile_names")
providers = offered(PROVIDERS)


def models(incomplete: str) -> list[str]:
    """Names for ``--model``."""
    from depthcli.models.catalog import list_locations

    return starting_with((name for name, _ in list_locations()), incomplete)


def models_and_cards(incomplete: str) -> list[str]:
    """Names of models, and of ready cards."""
    return [*models(incomplete), *cards(incomplete)]
