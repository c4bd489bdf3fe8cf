"""Static int8 quantisation, calibrated on the user's own pictures."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnx
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

from depthcli.datasets.files import spread
from depthcli.errors import InputError, UsageError
from depthcli.inference.preprocess import prepare
from depthcli.io.pictures.read import read_image
from depthcli.io.storage.temporary_folder import temporary_folder
from depthcli.models.card_specs import InputSpec

MOST_PICTURES = 64


def quantize(model: onnx.ModelProto, batches: Sequence[npt.NDArray[np.float32]]) -> onnx.ModelProto:
    """Weights and activations as int8, in the portable QDQ form, weights per channel.

    Weights keep to 7 of their 8 bits: processors with AVX2 alone add products in 16 bits, which
    whole ones would overflow. The batches, network inputs (1, C, H, W), show the range of each
    activation.
    """
    name = model.graph.input[0].name
    with temporary_folder() as folder:
        # By path, for the quantizer moves the weights of a model in memory to a file of its own.
        source, path = folder / "float.onnx", folder / "int8.onnx"
        onnx.save(model, source)
        with _without_advice():
            quantize_static(
                source,
                path,
                _Reader([{name: batch} for batch in batches]),
                quant_format=QuantFormat.QDQ,
                per_channel=True,
                reduce_range=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
            )
        return onnx.load(path)


def calibration_batches(folder: Path, spec: InputSpec) -> list[npt.NDArray[np.float32]]:
    """Network inputs of up to 64 pictures of a folder, spread evenly over it by name.

    Raises:
        UsageError: the folder is missing or has no picture.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder} is not a folder; give one with pictures to calibrate int8")
    files = sorted(path for path in folder.iterdir() if path.is_file())
    batches = []
    for path in [files[i] for i in spread(len(files), MOST_PICTURES)]:
        with suppress(InputError):  # notes and thumbnails' databases lie among pictures
            batches.append(prepare(spec, read_image(path))[0])
    if not batches:
        raise UsageError(f"{folder} has no picture; give one with pictures to calibrate int8")
    return batches


@contextmanager
def _without_advice() -> Iterator[None]:
    """Keep the quantizer's advice to fold the graph, which is folded, from standard error."""
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


class _Reader(CalibrationDataReader):  # type: ignore[misc]
    """Hands the inputs to onnxruntime one by one."""

    def __init__(self, feeds: list[dict[str, npt.NDArray[np.float32]]]) -> None:
        self._feeds = iter(feeds)

    def get_next(self) -> dict[str, npt.NDArray[np.float32]] | None:
        """The next input, or None at the end."""
        return next(self._feeds, None)
