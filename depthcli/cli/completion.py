"""Shell completion of the values of options and arguments, except file names."""

from collections.abc import Callable, Iterable

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


def cards(incomplete: str) -> list[str]:
    """Names of ready cards."""
    from depthcli.models.catalog import ready_names

    return starting_with(ready_names(), incomplete)


providers = offered(PROVIDERS)


def models(incomplete: str) -> list[str]:
    """Names for ``--model``."""
    from depthcli.models.catalog import list_locations

    return starting_with((name for name, _ in list_locations()), incomplete)


def models_and_cards(incomplete: str) -> list[str]:
    """Names of models, and of ready cards."""
    return [*models(incomplete), *cards(incomplete)]
