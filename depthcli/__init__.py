"""Depth from a single image.

The Python API, loaded name by name when it is used; docs/python.md tells more::

    import depthcli

    model = depthcli.load_model()
    depth = model.predict("room.jpg")
    depth.values  # (H, W) float32, metres
    depth.save("room.exr")
"""

from depthcli._version import __version__ as __version__

# The stable names by module; one that is not here may change at any time. Their types are in
# __init__.pyi.
_HOMES = {
    "depthcli.api.depth_map": ("DepthMap", "DepthPage"),
    "depthcli.api.files": ("DepthVideo", "VideoSource", "read_depth"),
    "depthcli.api.model": ("DepthModel", "load_model"),
    "depthcli.core.camera": ("Anchor", "CameraSource", "Intrinsics"),
    "depthcli.core.options": ("Detail", "Projection", "Upsampling", "UpsamplingOptions"),
    "depthcli.core.surface": ("PointCloud",),
    "depthcli.core.types": ("AnchorFit", "DepthKind", "Frame", "Provenance"),
    "depthcli.errors": (
        *("CheckpointError", "DatasetError", "DepthcliError", "DepthcliWarning", "EngineError"),
        *("InputError", "ModelError", "OutputError", "ParityError", "ProviderError"),
        *("TrainingError", "UsageError"),
    ),
    "depthcli.inference.pipeline": ("Pipeline",),
    "depthcli.inference.session": ("Session",),
    "depthcli.io.calibration": ("read_calibration",),
    "depthcli.io.images.read": ("ImageLike", "read_image"),
    "depthcli.models.card": ("ModelCard",),
    "depthcli.models.catalog": ("Model", "find_model"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
__all__ = sorted((*_HOME_OF, "__version__"))  # noqa: PLE0605 - the stub has the names


def __getattr__(name: str) -> object:
    home = _HOME_OF.get(name)
    if home is None:
        raise AttributeError(f"module 'depthcli' has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415 - a bare import costs nothing until here

    value: object = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
