"""onnxruntime's execution providers, by the names of the command line."""

import os

import onnxruntime as ort

from depthcli.errors import ProviderError, UsageError

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # it is read by the import, and only there

ort.set_default_logger_severity(3)  # errors: only they tell why a provider does not start

__all__ = ["ort"]

AUTO = "auto"
CPU = "cpu"
DIRECTML = "directml"
OPENVINO = "openvino"
PROVIDERS = {  #: name on the command line -> name in onnxruntime
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "rocm": "ROCMExecutionProvider",
    "migraphx": "MIGraphXExecutionProvider",
    DIRECTML: "DmlExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    OPENVINO: "OpenVINOExecutionProvider",
    CPU: "CPUExecutionProvider",
}
CUDA = "cuda", "tensorrt"
#: options of onnxruntime where none are given
DEFAULT_OPTIONS = {
    # Its exhaustive search takes .4 s for each new size of images. TF32 changes depth by .1 %.
    "cuda": {"cudnn_conv_algo_search": "HEURISTIC", "use_tf32": "0"},
}
SLOW_TO_START = "tensorrt"  #: builds an engine for minutes, so ``auto`` never selects it
_PACKAGES = {
    **dict.fromkeys(CUDA, "onnxruntime-gpu[cuda,cudnn]"),
    DIRECTML: "onnxruntime-directml",
    OPENVINO: "onnxruntime-openvino",
}
# Usually fastest first.
_AUTO_ORDER = tuple(name for name in PROVIDERS if name != SLOW_TO_START)


def available_providers() -> tuple[str, ...]:
    """Names of the providers that this onnxruntime was built with, best first."""
    built = set(ort.get_available_providers())
    return tuple(name for name, full in PROVIDERS.items() if full in built)


def wanted_providers(provider: str) -> tuple[str, ...]:
    """The providers to try, best first, for ``auto`` or a name of ``PROVIDERS``."""
    available = available_providers()
    if provider == AUTO:
        return tuple(name for name in _AUTO_ORDER if name in available)
    if provider not in PROVIDERS:
        names = ", ".join((AUTO, *PROVIDERS))
        raise UsageError(f"no provider named {provider!r}; give one of {names}")
    if provider not in available:
        install = "install the onnxruntime build for it"
        if provider in _PACKAGES:
            install = f"run 'pip uninstall onnxruntime' and 'pip install {_PACKAGES[provider]}'"
        raise ProviderError(
            f"provider {provider!r} is not in this onnxruntime (it has {', '.join(available)}); "
            f"{install}, or choose the provider 'auto'"
        )
    return (provider,)
