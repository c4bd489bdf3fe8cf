"""Depth from a single picture.

The Python API, loaded name by name when it is used::

    from pathlib import Path

    import depthcli

    pipeline = depthcli.load()
    depth = pipeline.predict(depthcli.read_image(Path("room.jpg")))
    depth.values  # (H, W) float32, metres
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from depthcli.core.choices import Detail, Upsampling
    from depthcli.core.types import DepthKind, DepthMap, Frame, Provenance
    from depthcli.errors import (
        CheckpointError,
        DatasetError,
        DepthcliError,
        InputError,
        ModelError,
        OutputError,
        ParityError,
        ProviderError,
        TrainingError,
        UsageError,
    )
    from depthcli.inference.card import ModelCard
    from depthcli.inference.catalog import Model, find_model
    from depthcli.inference.pipeline import Pipeline, load
    from depthcli.inference.session import Session
    from depthcli.io.depth_files import read_depth
    from depthcli.io.depth_videos import DepthVideo
    from depthcli.io.sources.image import read_image
    from depthcli.io.sources.video import VideoSource

__version__ = "0.1.0"

__all__ = [
    "CheckpointError",
    "DatasetError",
    "DepthKind",
    "DepthMap",
    "DepthVideo",
    "DepthcliError",
    "Detail",
    "Frame",
    "InputError",
    "Model",
    "ModelCard",
    "ModelError",
    "OutputError",
    "ParityError",
    "Pipeline",
    "Provenance",
    "ProviderError",
    "Session",
    "TrainingError",
    "Upsampling",
    "UsageError",
    "VideoSource",
    "__version__",
    "find_model",
    "load",
    "read_depth",
    "read_image",
]

_HOMES = {
    "depthcli.core.choices": ("Detail", "Upsampling"),
    "depthcli.core.types": ("DepthKind", "DepthMap", "Frame", "Provenance"),
    "depthcli.errors": tuple(name for name in __all__ if name.endswith("Error")),
    "depthcli.inference.card": ("ModelCard",),
    "depthcli.inference.catalog": ("Model", "find_model"),
    "depthcli.inference.pipeline": ("Pipeline", "load"),
    "depthcli.inference.session": ("Session",),
    "depthcli.io.depth_files": ("read_depth",),
    "depthcli.io.depth_videos": ("DepthVideo",),
    "depthcli.io.sources.image": ("read_image",),
    "depthcli.io.sources.video": ("VideoSource",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    home = _HOME_OF.get(name)
    if home is None:
        raise AttributeError(f"module 'depthcli' has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415 - a bare import costs nothing until here

    value: object = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
