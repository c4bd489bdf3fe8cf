"""What a shell offers for words that name something of ours; it offers file names by itself."""

from collections.abc import Iterable

# Asking onnxruntime would take seconds; a test compares these with what it knows.
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
    from depthcli.models.places import list_places

    return _beginning((name for name, _ in list_places()), incomplete)


def own_models(incomplete: str) -> list[str]:
    """Names of models that were added."""
    from depthcli.models.places import list_places, user_root

    root = user_root()
    return _beginning((n for n, p in list_places() if p.path.is_relative_to(root)), incomplete)


def models_and_cards(incomplete: str) -> list[str]:
    """Names of models, and of ready cards."""
    return [*models(incomplete), *cards(incomplete)]


def cards(incomplete: str) -> list[str]:
    """Names of ready cards."""
    from depthcli.models.ready_cards import ready_names

    return _beginning(ready_names(), incomplete)


def profiles(incomplete: str) -> list[str]:
    """Names of saved profiles."""
    from depthcli.cli.profile_files import profile_names

    return _beginning(profile_names(), incomplete)


def presets(incomplete: str) -> list[str]:
    """Names for ``--preset``."""
    from depthcli.training.config.presets import preset_names

    return _beginning(preset_names(), incomplete)


def providers(incomplete: str) -> list[str]:
    """Names for ``--provider``."""
    return _beginning(PROVIDERS, incomplete)


def methods(incomplete: str) -> list[str]:
    """The methods of training."""
    from depthcli.training.methods.table import METHODS

    return _beginning(METHODS, incomplete)


def method_lists(incomplete: str) -> list[str]:
    """The methods again, behind those that stand before the last comma."""
    before, comma, last = incomplete.rpartition(",")
    return [f"{before}{comma}{name}" for name in methods(last) if name not in before.split(",")]


def accelerators(incomplete: str) -> list[str]:
    """Names for ``--accelerator``."""
    return _beginning(ACCELERATORS, incomplete)


def _beginning(words: Iterable[str], incomplete: str) -> list[str]:
    return [word for word in words if word.startswith(incomplete)]
