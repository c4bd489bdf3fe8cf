"""One onnxruntime session: which provider runs it, with how many threads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import onnxruntime as ort

from depthcli.errors import ModelError, ProviderError

if TYPE_CHECKING:
    import numpy.typing as npt

    from depthcli.inference.catalog import Model

AUTO = "auto"
PROVIDERS = {
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "rocm": "ROCMExecutionProvider",
    "migraphx": "MIGraphXExecutionProvider",
    "directml": "DmlExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "cpu": "CPUExecutionProvider",
}
"""Name on the command line -> name in onnxruntime."""
# In the order of what usually is fastest; TensorRT is left out because it builds an engine for
# minutes before the first picture.
_AUTO_ORDER = ("cuda", "rocm", "migraphx", "directml", "coreml", "cpu")
_FATAL_ONLY = 4
_IMAGE_RANK = 4


def available_providers() -> tuple[str, ...]:
    """Names of the providers that this onnxruntime was built with, best first."""
    built = set(ort.get_available_providers())
    return tuple(name for name, full in PROVIDERS.items() if full in built)


class Session:
    """A loaded model.

    Attributes:
        model: the model behind it.
        provider: name of the provider that really runs it.
        warnings: one-line texts, if ``auto`` had to settle for less than was there.
    """

    def __init__(self, model: Model, *, provider: str = AUTO, threads: int | None = None) -> None:
        """Load a model.

        Args:
            model: from the catalog.
            provider: ``auto`` for the best that works, or a name of ``PROVIDERS``.
            threads: threads within one operator; None for onnxruntime's choice.

        Raises:
            ProviderError: the named provider is unknown, not built in, or does not start.
            ModelError: onnxruntime cannot load the model, or it is not an image-to-depth model.
        """
        self.model = model
        wanted = _wanted(provider)
        self._session = _load(model, wanted, threads)
        self.provider = _short_name(self._session.get_providers()[0])
        self.warnings = _provider_warnings(provider, wanted, self.provider)
        self._input = _image_input(self._session, model)

    def run(self, batch: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Run the network.

        Args:
            batch: (N, C, H, W) float32, normalised as the card says.

        Returns:
            (N, h, w) float32, the raw output of the card's codec.

        Raises:
            ModelError: onnxruntime failed, or the output is not one map for each picture.
        """
        try:
            raw = self._session.run(None, {self._input: batch})[0]
        except Exception as error:
            raise ModelError(
                f"{self.model.path} failed on an input of {batch.shape}: {_first_line(error)}"
            ) from error
        if raw.ndim == _IMAGE_RANK and raw.shape[1] == 1:
            raw = raw[:, 0]
        if raw.ndim != _IMAGE_RANK - 1 or len(raw) != len(batch):
            raise ModelError(
                f"{self.model.path} gives {raw.shape}, not one depth map a picture; "
                "use a depth model"
            )
        return np.asarray(raw, np.float32)


def _wanted(provider: str) -> tuple[str, ...]:
    available = available_providers()
    if provider == AUTO:
        return tuple(name for name in _AUTO_ORDER if name in available)
    if provider not in PROVIDERS:
        names = ", ".join((AUTO, *PROVIDERS))
        raise ProviderError(f"no provider is called {provider!r}; give one of {names}")
    if provider not in available:
        raise ProviderError(
            f"provider {provider!r} is not in this onnxruntime (it has {', '.join(available)}); "
            "install the onnxruntime build for it, or give --provider auto"
        )
    return (provider,)


def _load(model: Model, wanted: tuple[str, ...], threads: int | None) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.log_severity_level = _FATAL_ONLY
    if threads is not None:
        options.intra_op_num_threads = threads
    else:
        # Threads that spin between operators take time from loading, decoding and encoding on the
        # other cores: without, the first picture is there in half the time, and the next ones are
        # as fast. That holds for onnxruntime's own pinned threads, not for a number of them.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return ort.InferenceSession(model.data, options, [PROVIDERS[name] for name in wanted])
    except Exception as error:
        raise _load_error(model, wanted, error) from error


def _load_error(model: Model, wanted: tuple[str, ...], error: Exception) -> ModelError:
    if wanted[0] != "cpu" and "CPUExecutionProvider" not in str(error):
        return ProviderError(f"provider {wanted[0]!r} does not start: {_first_line(error)}")
    return ModelError(
        f"onnxruntime {ort.__version__} cannot load {model.path} "
        f"(opset {model.card.onnx.opset}, IR {model.card.onnx.ir}): {_first_line(error)}"
    )


def _provider_warnings(asked: str, wanted: tuple[str, ...], active: str) -> tuple[str, ...]:
    if active == wanted[0]:
        return ()
    # onnxruntime falls back to the CPU by itself; asked for by name, that is an error.
    if asked != AUTO:
        raise ProviderError(
            f"provider {asked!r} does not start here, onnxruntime fell back to {active!r}; "
            "see 'depthcli doctor', or give --provider auto"
        )
    return (f"provider {wanted[0]!r} does not start here, running on {active!r}",)


def _short_name(full: str) -> str:
    return next((name for name, value in PROVIDERS.items() if value == full), full)


def _image_input(session: ort.InferenceSession, model: Model) -> str:
    """The name of the one (N, C, H, W) float32 input."""
    inputs: list[Any] = session.get_inputs()
    channels = model.card.input.colour.channels
    first = inputs[0]
    if len(inputs) != 1 or len(first.shape) != _IMAGE_RANK or first.type != "tensor(float)":
        raise ModelError(
            f"{model.path} has no single float32 (N, C, H, W) input; use a depth model"
        )
    if isinstance(first.shape[1], int) and first.shape[1] != channels:
        raise ModelError(
            f"{model.path} takes {first.shape[1]} channels, its card says {channels}; "
            "correct the card's input.colour"
        )
    return str(first.name)


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]
