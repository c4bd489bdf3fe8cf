"""An onnxruntime session with its provider and threads."""

import os
import re
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import onnxruntime as ort

from depthcli.core.options import one_line
from depthcli.core.parallel import usable_cores
from depthcli.core.types import AnyArray, Float32Array
from depthcli.errors import ModelError, ProviderError, UsageError
from depthcli.models.card import fit_to_graph
from depthcli.models.catalog import Model

__all__ = ["ort"]

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # it is read by the import, and only there

ort.set_default_logger_severity(3)  # errors: only they tell why a provider does not start

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


_NAMES = frozenset({"depth", "disparity", "predicted_depth", "metric_depth"})
_INPUT_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
_IMAGE_RANK, _MATRIX_RANK = 4, 3
_POINT = 3  # numbers
_Prompts = Sequence[Float32Array | None] | None


def _output_names(session: ort.InferenceSession, model: Model) -> dict[str, str]:
    """Names of the outputs by their fields of :class:`RawOutputs`; the first is the depth map's.

    That is the output that the card names, the only one, or one of ``_NAMES``.
    """
    outputs: list[Any] = session.get_outputs()
    card, depth_name = model.card, model.card.onnx.output
    names = _NAMES if depth_name is None else {depth_name}
    present = [output for output in outputs if output.name in names]
    if depth_name is None and len(outputs) == 1:
        present = outputs
    listed = one_line(", ".join(f"{output.name} {output.shape}" for output in outputs))
    if len(present) != 1:
        choice = "which of them is the depth map" if depth_name is None else "one of them"
        raise ModelError(
            f"{model.path} has the outputs {listed}; state {choice} in the card, as onnx.output"
        )
    others = {
        "mask": card.output.mask and card.output.mask.output,
        "hfov_deg": card.camera and card.camera.hfov_output,
        "scale": card.output.points and card.output.points.scale_output,
    }
    named = {"maps": str(present[0].name)} | {field: name for field, name in others.items() if name}
    for name in named.values():
        if name not in {output.name for output in outputs}:
            raise ModelError(f"{model.path} has no output {name!r}, but {listed}; correct the card")
    return named


class RawOutputs(NamedTuple):
    """The outputs of a network for some images."""

    maps: Float32Array  #: (N, h, w), of the card's codec; (N, h, w, 3) of points
    mask: Float32Array | None = None  #: (N, h, w), of the card's mask; None without one
    hfov_deg: Float32Array | None = None  #: (N,); None if the network gives none
    scale: Float32Array | None = None  #: (N,) factor of points; None for 1

    def image(self, i: int) -> "RawOutputs":
        """The outputs of one image, without the first axis."""
        more = (None if output is None else output[i] for output in self[1:])
        return RawOutputs(self.maps[i], *more)


_FATAL_ONLY = 4
_SOURCE_LOCATION = r"^\S+\.(cc|cpp|h):\d+ .*?\) (?=\S)"


class Session:
    """A model on the provider that is active.

    Attributes:
        warnings: one-line texts, if ``auto`` fell back to a slower provider.
        takes_one: whether the graph was exported for a single image.
        fixed_size: (height, width) that the graph states, in pixels; None where it is dynamic.
        load_known_depth: loads :attr:`known_depth` when it is needed; None if there is none.
        load_error: the session that estimates the error of depth, loaded once; None for none.
        on_stop: called by :meth:`stop`, for copies of the session in other processes.
    """

    def __init__(
        self,
        model: Model,
        *,
        provider: str = AUTO,
        threads: int | None = None,
        provider_options: Mapping[str, str] | None = None,
    ) -> None:
        self.model = model
        names = wanted_providers(provider)
        options = provider_options or {}
        if options and provider in {AUTO, CPU}:
            advice = "name one such as cuda with {provider}, or remove {provider_options}"
            raise UsageError(f"provider {provider!r} takes no options", advice)
        self.provider_options = dict(options)
        self.load_known_depth: Callable[[], Session] | None = None
        self.load_error: Callable[[], Session] | None = None
        self.on_stop: Callable[[], None] | None = None
        self._session = _start(model, names, threads, options)
        self._run_options = ort.RunOptions()
        active = self._session.get_providers()[0]
        self.provider = next((name for name, full in PROVIDERS.items() if full == active), active)
        self.warnings: tuple[str, ...] = ()
        if self.provider != names[0]:  # onnxruntime falls back to the CPU by itself
            problem = f"provider {names[0]!r} does not start here"
            if provider != AUTO:
                advice = "onnxruntime says why, above; or give {provider} auto"
                raise ProviderError(f"{problem}, and {self.provider!r} would run", advice)
            self.warnings = (f"{problem}, running on {self.provider!r}",)
        # DirectML allows one run at a time in a session:
        # https://onnxruntime.ai/docs/execution-providers/DirectML-ExecutionProvider.html
        self._run_lock: AbstractContextManager[Any] = (
            threading.Lock() if self.provider == DIRECTML else nullcontext()
        )
        self._outputs = _output_names(self._session, model)
        self._input, shape = _image_input(self._session, model)
        self._input_type = _INPUT_TYPES[self._session.get_inputs()[0].type]
        self.takes_one, self.fixed_size = shape[0] == 1, (shape[2], shape[3])

    def run(self, batch: Float32Array, prompts: _Prompts = None) -> Float32Array:
        """The maps of :meth:`outputs`, (N, h, w) float32."""
        return self.outputs(batch, prompts).maps

    def outputs(
        self,
        batch: Float32Array,
        prompts: _Prompts = None,
        cameras: Sequence[Float32Array | None] = (),
    ) -> RawOutputs:
        """Run the network on (N, C, H, W) float32, normalized as the card says.

        ``prompts`` are known depth for a network that takes it, (C, H, W) float32 of each image
        with an input in each channel; None where nothing is known. ``cameras`` are the camera
        matrices, (3, 3) float32 of each image, for a network that takes them.
        """
        feed = {self._input: batch}
        spec = self.model.card.input
        if spec.prompt_inputs:
            grid = spec.known_depth
            size = batch.shape[2:] if grid is None else (grid.height, grid.width)
            nothing = np.zeros((len(spec.prompt_inputs), *size), np.float32)
            each = [None] * len(batch) if prompts is None else prompts
            stacked = np.stack([nothing if points is None else points for points in each])
            feed |= {name: stacked[:, i : i + 1] for i, name in enumerate(spec.prompt_inputs)}
        if spec.camera_matrix is not None:
            feed[spec.camera_matrix] = np.asarray(cameras, np.float32)
        if spec.layout == "nhwc":
            feed[self._input] = np.ascontiguousarray(batch.transpose(0, 2, 3, 1))
        feed = {name: values.astype(self._input_type, copy=False) for name, values in feed.items()}
        try:
            with self._run_lock:
                raw = self._session.run([*self._outputs.values()], feed, self._run_options)
        except Exception as error:
            fit_to_graph(self.model.card, self.fixed_size, self.model.path, adapt=False)
            raise ModelError(
                f"{self.model.path} failed on an input of {batch.shape}: {_first_line(error)}"
            ) from error
        by_name = dict(zip(self._outputs, raw, strict=True))
        for name in {"maps", "mask"} & by_name.keys():
            by_name[name] = self._maps(by_name[name], len(batch))
        for name in {"hfov_deg", "scale"} & by_name.keys():
            by_name[name] = np.asarray(by_name[name], np.float32).reshape(len(batch))
        return RawOutputs(**by_name)

    @cached_property
    def known_depth(self) -> "Session | None":
        """The session that takes the place of this one where depth is known; None for none."""
        return self.load_known_depth and self.load_known_depth()

    def identity(self, *, knows_depth: bool = False) -> tuple[object, ...]:
        """What depth depends on besides the image and the options, for fingerprints.

        That is the weights, the card, which is not part of their file, and the provider, because
        providers differ in the last digits. With ``knows_depth``, the network for known depth
        counts as well.
        """
        card, other = self.model.card, self.known_depth if knows_depth else None
        identity = self.model.sha256, card.input, card.output, card.camera
        return (*identity, self.provider, self.provider_options, other and other.identity())

    def stop(self) -> None:
        """Terminate all runs, current and later ones, which fail then; from any thread."""
        self._run_options.terminate = True
        if self.on_stop is not None:
            self.on_stop()
        if (other := vars(self).get("known_depth")) is not None:
            other.stop()

    def _maps(self, raw: AnyArray, count: int) -> Float32Array:
        """An output of (N, h, w), (N, 1, h, w) or (N, h, w, 1) as (N, h, w) float32.

        One of points, (N, h, w, 3), stays as it is; (h, w) is that of a single image.
        """
        if self.model.card.output.points and raw.shape[::3] == (count, _POINT):
            return np.asarray(raw, np.float32)
        is_single = raw.ndim == _IMAGE_RANK - 2 and count == 1 < min(raw.shape)
        maps = raw[np.newaxis] if is_single else raw
        if raw.ndim == _IMAGE_RANK:
            maps = raw[:, 0] if raw.shape[1] == 1 else raw[..., 0] if raw.shape[3] == 1 else raw
        if maps.ndim != _IMAGE_RANK - 1 or len(maps) != count:
            raise ModelError(
                f"{self.model.path} gives {raw.shape}, not one depth map an image: (N, h, w), "
                "(N, 1, h, w) or (N, h, w, 1); use a depth model, or export it again"
            )
        return np.asarray(maps, np.float32)


def _start(
    model: Model, names: tuple[str, ...], threads: int | None, provider_options: Mapping[str, str]
) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.log_severity_level = _FATAL_ONLY
    if threads is not None:
        options.intra_op_num_threads = threads
    if threads is None or threads > usable_cores():
        # Threads that spin between operators take time from loading, decoding and encoding on the
        # other cores: without spinning, the first image is faster and the next ones are as fast.
        # That holds for onnxruntime's default pinned threads, not for a given number; but more
        # threads than cores would slow each other down, 1024 of them for a minute.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if DIRECTML in names:  # it supports neither memory patterns nor parallel execution
        options.enable_mem_pattern = False
        options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    if names[0] in CUDA and hasattr(ort, "preload_dlls"):  # since 1.21
        with redirect_stdout(sys.stderr):  # which has what is missing
            ort.preload_dlls()  # of CUDA and cuDNN that pip installed, where no search path leads
    configured = [
        (PROVIDERS[name], DEFAULT_OPTIONS.get(name, {}) | dict(provider_options)) for name in names
    ]
    try:
        # onnxruntime's own fallback to the CPU prints to standard output.
        source = str(model.path) if model.data is None else model.data
        return ort.InferenceSession(source, options, configured, enable_fallback=0)
    except Exception as error:
        reason = _first_line(error)
        if names[0] == CPU or "CPUExecutionProvider" in str(error):
            versions = f"opset {model.card.onnx.opset}, IR {model.card.onnx.ir}"
            problem = f"onnxruntime {ort.__version__} cannot load {model.path} ({versions})"
            raise ModelError(f"{problem}: {reason}") from error
        if len(names) == 1:
            raise ProviderError(f"provider {names[0]!r} does not start: {reason}") from error
        return _start(model, names[1:], threads, provider_options)  # the caller warns of it


def _image_input(session: ort.InferenceSession, model: Model) -> tuple[str, tuple[int | None, ...]]:
    """Name and (N, C, H, W) of the image's float input; None where a length is dynamic."""
    inputs: list[Any] = session.get_inputs()
    names, matrix = model.card.input.prompt_inputs, model.card.input.camera_matrix
    kinds = [(len(entry.shape), entry.type) for entry in inputs]
    ranks = [_IMAGE_RANK] * (1 + len(names)) + [_MATRIX_RANK] * (matrix is not None)
    names += () if matrix is None else (matrix,)
    usual = ([(rank, kind) for rank in ranks] for kind in _INPUT_TYPES)
    if kinds not in usual or tuple(entry.name for entry in inputs[1:]) != names:
        listed = one_line(", ".join(f"{entry.name} {entry.shape} {entry.type}" for entry in inputs))
        problem = f"{model.path} has the inputs {listed or 'none'}"
        what = "input.prompt or input.camera_matrix"
        advice = f"export it with one float32 input (N, C, H, W), or state {what} in its card"
        raise ModelError(problem, advice)
    first, spec = inputs[0], model.card.input
    lengths = [length if isinstance(length, int) else None for length in first.shape]
    is_last = spec.layout == "nhwc"
    channels = lengths.pop(3 if is_last else 1)
    if channels not in {None, spec.colour.channels}:
        raise ModelError(
            f"{model.path} takes {first.shape}, but its card says {spec.colour.channels} channels, "
            f"{spec.layout}; correct input.colour or input.layout in the card"
        )
    return str(first.name), (lengths[0], channels, *lengths[1:])


def _first_line(error: Exception) -> str:
    """The first line of a message, without the location in onnxruntime's source."""
    return one_line(re.sub(_SOURCE_LOCATION, "", str(error).strip().partition("\n")[0]))
