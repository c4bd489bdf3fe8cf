"""Depth from a single picture.

The Python API, loaded name by name when it is used; docs/python.md tells more::

    import depthcli

    model = depthcli.load_model("default")
    depth = model.predict("room.jpg")
    depth.values  # (H, W) float32, metres
    depth.save("room.exr")
"""

from __future__ import annotations

from depthcli._version import __version__

TYPE_CHECKING = False  # checkers take it for typing's, which would be a quarter of ``--help``
if TYPE_CHECKING:
    from depthcli.api.depth_map import DepthMap, DepthPage
    from depthcli.api.files import DepthVideo, VideoSource, read_depth
    from depthcli.api.model import DepthModel, load_model
    from depthcli.core.camera import Anchor, CameraSource, Intrinsics
    from depthcli.core.options import Projection, Upsampling, UpsamplingOptions
    from depthcli.core.point_cloud import PointCloud
    from depthcli.core.types import AnchorFit, DepthKind, Frame, Provenance
    from depthcli.errors import (
        CheckpointError,
        DatasetError,
        DepthcliError,
        DepthcliWarning,
        EngineError,
        InputError,
        ModelError,
        OutputError,
        ParityError,
        ProviderError,
        TrainingError,
        UsageError,
    )
    from depthcli.inference.pipeline import Pipeline
    from depthcli.inference.session import Session
    from depthcli.io.calibration import read_calibration
    from depthcli.io.images.read import Picture, read_image
    from depthcli.models.card import ModelCard
    from depthcli.models.catalog import Model, find_model

# The stable names; one that is not here may change at any time.
__all__ = [
    "Anchor",
    "AnchorFit",
    "CameraSource",
    "CheckpointError",
    "DatasetError",
    "DepthKind",
    "DepthMap",
    "DepthModel",
    "DepthPage",
    "DepthVideo",
    "DepthcliError",
    "DepthcliWarning",
    "EngineError",
    "Frame",
    "InputError",
    "Intrinsics",
    "Model",
    "ModelCard",
    "ModelError",
    "OutputError",
    "ParityError",
    "Picture",
    "Pipeline",
    "PointCloud",
    "Projection",
    "Provenance",
    "ProviderError",
    "Session",
    "TrainingError",
    "Upsampling",
    "UpsamplingOptions",
    "UsageError",
    "VideoSource",
    "__version__",
    "find_model",
    "load_model",
    "read_calibration",
    "read_depth",
    "read_image",
]

_HOMES = {
    "depthcli.api.depth_map": ("DepthMap", "DepthPage"),
    "depthcli.api.files": ("DepthVideo", "VideoSource", "read_depth"),
    "depthcli.api.model": ("DepthModel", "load_model"),
    "depthcli.core.camera": ("Anchor", "CameraSource", "Intrinsics"),
    "depthcli.core.options": ("Detail", "Projection", "Upsampling", "UpsamplingOptions"),
    "depthcli.core.point_cloud": ("PointCloud",),
    "depthcli.core.types": ("AnchorFit", "DepthKind", "Frame", "Provenance"),
    "depthcli.errors": tuple(name for name in __all__ if name.endswith(("Error", "Warning"))),
    "depthcli.inference.pipeline": ("Pipeline",),
    "depthcli.inference.session": ("Session",),
    "depthcli.io.calibration": ("read_calibration",),
    "depthcli.io.images.read": ("Picture", "read_image"),
    "depthcli.models.card": ("ModelCard",),
    "depthcli.models.catalog": ("Model", "find_model"),
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
