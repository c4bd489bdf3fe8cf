"""The files whose weights a run starts from."""

from pathlib import Path

from depthcli.errors import CheckpointError
from depthcli.models.catalog import find_model

_CHECKPOINT_SUFFIX = ".ckpt"
_ONNX_SUFFIX = ".onnx"


def weights_file(source: Path) -> Path:
    """The checkpoint, or the ONNX file of a model; of an int8 model, that of its float model.

    Args:
        source: a checkpoint, or a model as :func:`~depthcli.models.catalog.find_model` takes it.

    Raises:
        CheckpointError: there is no such checkpoint.
        ModelError: there is no such model, or it is damaged.
    """
    if source.suffix != _ONNX_SUFFIX and source.is_file():
        return source
    if source.suffix == _CHECKPOINT_SUFFIX:
        raise CheckpointError(f"no checkpoint at {source}")
    model = find_model(source)
    return find_model(model.card.float_model).path if model.card.float_model else model.path
