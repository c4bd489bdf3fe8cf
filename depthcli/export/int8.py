"""Static int8 quantization, calibrated on given pictures."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnx
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

from depthcli.datasets.files import sample_positions
from depthcli.errors import InputError, UsageError
from depthcli.inference.preprocess import prepare
from depthcli.io.images.read import read_image
from depthcli.io.listing.folder import is_video, list_folder
from depthcli.io.storage.temporary_folder import temporary_folder
from depthcli.models.card_specs import InputSpec

MAX_PICTURES = 64


def quantize(model: onnx.ModelProto, batches: Sequence[npt.NDArray[np.float32]]) -> onnx.ModelProto:
    """Quantize weights (per channel) and activations to int8, in QDQ format.

    Weights use 7 bits: CPUs with AVX2 but without VNNI accumulate in 16 bits, which 8-bit weights
    could overflow. The batches, network inputs (1, C, H, W), calibrate the range of activations.
    """
    name = model.graph.input[0].name
    with temporary_folder() as folder:
        # By path, as the quantizer moves the weights of a model in memory to a separate file.
        source, path = folder / "float.onnx", folder / "int8.onnx"
        onnx.save(model, source)
        with _suppress_warnings():
            quantize_static(
                source,
                path,
                _CalibrationReader([{name: batch} for batch in batches]),
                quant_format=QuantFormat.QDQ,
                per_channel=True,
                reduce_range=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
            )
        return onnx.load(path)


def calibration_batches(folder: Path, spec: InputSpec) -> list[npt.NDArray[np.float32]]:
    """Network inputs of up to 64 pictures of a folder and its subfolders, spread evenly by name.

    Raises:
        UsageError: the folder is missing or has no picture, or holds ``rgb`` beside ``depth``.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder} is not a folder; give one with pictures to calibrate int8")
    if all((folder / name).is_dir() for name in ("rgb", "depth")):
        raise UsageError(f"{folder} has depth beside its pictures; give {folder / 'rgb'} for int8")
    listed = list_folder(str(folder)).media
    files = sorted(Path(file.path) for file in listed if not is_video(file.name))
    batches = []
    for i in sample_positions(len(files), MAX_PICTURES):
        with suppress(InputError):  # damaged ones
            batches.append(prepare(spec, read_image(files[i]))[0])
    if not batches:
        raise UsageError(f"{folder} has no picture; give one with pictures to calibrate int8")
    return batches


@contextmanager
def _suppress_warnings() -> Iterator[None]:
    """Suppress the advice to preprocess the model, which has been done."""
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


class _CalibrationReader(CalibrationDataReader):  # type: ignore[misc]
    """Gives the inputs to onnxruntime one by one."""

    def __init__(self, feeds: list[dict[str, npt.NDArray[np.float32]]]) -> None:
        self._feeds = iter(feeds)

    def get_next(self) -> dict[str, npt.NDArray[np.float32]] | None:
        """The next input, or None at the end."""
        return next(self._feeds, None)
