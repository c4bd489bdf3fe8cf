"""Shell completion of the values of options and arguments, except file names."""

from collections.abc import Iterable

# Importing onnxruntime is slow; a test compares these names with it.
PROVIDERS = (
    "auto",
    "cpu",
    "cuda",
    "tensorrt",
    "rocm",
    "migraphx",
    "directml",
    "coreml",
    "openvino",
)
ACCELERATORS = ("auto", "cpu", "cuda", "mps")


def models(incomplete: str) -> list[str]:
    """Names for ``--model``."""
    from depthcli.models.catalog import list_locations

    return starting_with((name for name, _ in list_locations()), incomplete)


def added_models(incomplete: str) -> list[str]:
    """Names of models that were added."""
    from depthcli.models.catalog import list_locations, user_root

    root = user_root()
    return starting_with(
        (n for n, p in list_locations() if p.path.is_relative_to(root)), incomplete
    )


def models_and_cards(incomplete: str) -> list[str]:
    """Names of models, and of ready cards."""
    return [*models(incomplete), *cards(incomplete)]


def cards(incomplete: str) -> list[str]:
    """Names of ready cards."""
    from depthcli.models.catalog import ready_names

    return starting_with(ready_names(), incomplete)


def presets(incomplete: str) -> list[str]:
    """Names for ``--preset``."""
    from depthcli.training.presets import PRESETS

    return starting_with(PRESETS, incomplete)


def providers(incomplete: str) -> list[str]:
    """Names for ``--provider``."""
    return starting_with(PROVIDERS, incomplete)


def methods(incomplete: str) -> list[str]:
    """The training methods."""
    from depthcli.training.methods.table import METHODS

    return starting_with(METHODS, incomplete)


def method_lists(incomplete: str) -> list[str]:
    """Completions of the last method of a comma-separated list."""
    before, comma, last = incomplete.rpartition(",")
    return [f"{before}{comma}{name}" for name in methods(last) if name not in before.split(",")]


def accelerators(incomplete: str) -> list[str]:
    """Names for ``--accelerator``."""
    return starting_with(ACCELERATORS, incomplete)


def starting_with(words: Iterable[str], incomplete: str) -> list[str]:
    """The words that complete one."""
    return [word for word in words if word.startswith(incomplete)]
