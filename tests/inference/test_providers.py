"""Providers: what is tried, what is refused, what is said of it."""

import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
import pytest
from helpers.tiny import load, write_model

from depthcli.errors import ProviderError, UsageError
from depthcli.inference import session
from depthcli.inference.loading import SessionLoader
from depthcli.inference.session import Session
from depthcli.models.catalog import find_model

REAL = ort.InferenceSession


def built_with(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Let this onnxruntime look like a build that has these providers."""
    full = [session.PROVIDERS[name] for name in names]
    monkeypatch.setattr(ort, "get_available_providers", lambda: full)


def starting(monkeypatch: pytest.MonkeyPatch, broken: str) -> list[dict[str, dict[str, str]]]:
    """Let sessions be real ones on the CPU, but fail where one provider is among the wanted.

    Returns:
        What is wanted of each session, with its options.
    """
    attempts: list[dict[str, dict[str, str]]] = []

    def start(data: bytes, options: Any, providers: list[Any], *, enable_fallback: int) -> Any:
        attempts.append(dict(providers))
        if session.PROVIDERS[broken] in attempts[-1]:
            raise RuntimeError("no such device\nsecond line")
        return REAL(data, options, ["CPUExecutionProvider"], enable_fallback=enable_fallback)

    monkeypatch.setattr(session.ort, "InferenceSession", start)
    return attempts


@pytest.mark.parametrize(
    ("there", "expected"),
    [
        (("cpu",), ("cpu",)),
        (("cpu", "tensorrt", "cuda"), ("cuda", "cpu")),
        (("openvino", "cpu"), ("openvino", "cpu")),
        (("directml", "cpu"), ("directml", "cpu")),
        (("coreml", "cpu"), ("coreml", "cpu")),
    ],
)
def test_auto_tries_the_best_first_and_never_tensorrt(
    monkeypatch: pytest.MonkeyPatch, there: tuple[str, ...], expected: tuple[str, ...]
) -> None:
    built_with(monkeypatch, *there)
    assert session.wanted_providers("auto") == expected


@pytest.mark.parametrize("name", [n for n in session.PROVIDERS if n != "cpu"])
def test_a_named_provider_that_is_absent_fails(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    built_with(monkeypatch, "cpu")
    with pytest.raises(ProviderError, match=rf"'{name}' is not in this .* \(it has cpu\)") as error:
        session.wanted_providers(name)
    assert ("pip install" in str(error.value)) == (name in session._PACKAGES)
    with pytest.raises(UsageError):
        session.wanted_providers(f"{name}s")
    built_with(monkeypatch, *session.PROVIDERS)
    assert session.wanted_providers(name) == (name,)  # alone


def test_a_provider_that_does_not_start_is_left_by_auto_with_a_warning(
    monkeypatch: pytest.MonkeyPatch, model_folder: Path
) -> None:
    built_with(monkeypatch, "cuda", "cpu")
    attempts = starting(monkeypatch, "cuda")
    loaded = Session(find_model(model_folder))
    cuda, cpu = "CUDAExecutionProvider", "CPUExecutionProvider"
    assert [*map(list, attempts)] == [[cuda, cpu], [cpu]]
    assert loaded.provider == "cpu"
    assert loaded.warnings == ("provider 'cuda' does not start here, running on 'cpu'",)
    with pytest.raises(ProviderError, match=r"'cuda' does not start: no such device$"):
        Session(find_model(model_folder), provider="cuda")
    assert [*map(list, attempts[2:])] == [[cuda]]


def test_a_named_provider_is_never_replaced_in_silence(
    monkeypatch: pytest.MonkeyPatch, model_folder: Path
) -> None:
    """onnxruntime falls back to the CPU by itself."""
    built_with(monkeypatch, "cuda", "cpu")
    starting(monkeypatch, "rocm")
    with pytest.raises(ProviderError):
        Session(find_model(model_folder), provider="cuda")
    assert len(Session(find_model(model_folder)).warnings) == 1


@pytest.mark.parametrize("name", ["auto", "cpu"])
def test_options_need_a_provider_that_takes_them(model_folder: Path, name: str) -> None:
    with pytest.raises(UsageError):
        Session(find_model(model_folder), provider=name, provider_options={"device_id": "1"})
    with pytest.raises(UsageError):
        load(model_folder, provider=name, provider_options={"device_id": "1"})


def test_options_reach_the_provider(monkeypatch: pytest.MonkeyPatch, model_folder: Path) -> None:
    """The search of cuDNN takes .4 s for each new size of images, unless it is told otherwise."""
    built_with(monkeypatch, "cuda", "cpu")
    attempts = starting(monkeypatch, "cuda")
    usual = {"cudnn_conv_algo_search": "HEURISTIC", "use_tf32": "0"}
    for options in ({"device_id": "1"}, {"use_tf32": "1"}):
        with pytest.raises(ProviderError):
            Session(find_model(model_folder), provider="cuda", provider_options=options)
        assert attempts[-1] == {"CUDAExecutionProvider": usual | options}


class Claiming(REAL):
    """A session on the CPU that states the wanted providers, and counts how many run at once."""

    running = most = 0

    def __init__(self, data: bytes, options: Any, providers: list[Any], **others: Any) -> None:
        super().__init__(data, options, ["CPUExecutionProvider"], **others)
        self.get_providers = lambda: [name for name, _ in providers]

    def run(self, *arguments: Any) -> Any:
        self.running += 1
        self.most = max(self.most, self.running)
        time.sleep(0.01)
        result = super().run(*arguments)
        self.running -= 1
        return result


def test_directml_runs_one_at_a_time(monkeypatch: pytest.MonkeyPatch, model_folder: Path) -> None:
    built_with(monkeypatch, "directml", "cpu")
    monkeypatch.setattr(session.ort, "InferenceSession", Claiming)
    loaded = Session(find_model(model_folder))
    assert (loaded.provider, loaded.warnings) == ("directml", ())
    options = loaded._session.get_session_options()
    assert options.enable_mem_pattern is False
    assert options.execution_mode == ort.ExecutionMode.ORT_SEQUENTIAL
    with ThreadPoolExecutor(4) as pool:
        assert len([*pool.map(loaded.run, [np.zeros((1, 1, 4, 4), np.float32)] * 4)]) == 4
    assert loaded._session.most == 1


@pytest.mark.parametrize(
    ("there", "provider", "expected"),
    [
        (("cuda", "cpu"), "auto", "float"),
        (("cuda", "cpu"), "cpu", "int8"),
        (("cuda", "cpu"), "cuda", "float"),
        (("openvino", "cpu"), "auto", "float"),
        (("cpu",), "auto", "int8"),
    ],
)
def test_a_gpu_gets_the_model_of_floats_that_the_card_names(
    monkeypatch: pytest.MonkeyPatch,
    models: Path,
    there: tuple[str, ...],
    provider: str,
    expected: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    write_model(models / "float", name="float")
    write_model(models / "int8", name="int8", float_model="float")
    built_with(monkeypatch, *there)
    monkeypatch.setattr(session.ort, "InferenceSession", Claiming)
    caplog.set_level("INFO")
    loaded = SessionLoader("int8", provider, threads=2).load()
    assert f"on {loaded.provider}, 2 threads" in caplog.text
    assert loaded.model.card.name == expected
    assert loaded.provider == (there[0] if provider == "auto" else provider)
    assert loaded._session.get_session_options().intra_op_num_threads == 2


def test_the_cpu_has_its_model_if_no_gpu_works(
    monkeypatch: pytest.MonkeyPatch, models: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The CUDA that pip installed was not found: danielgatis/rembg#668, microsoft/onnxruntime#21684.
    missing = "Failed to load libcublasLt.so.13\n"
    tell = lambda: sys.stdout.write(missing)  # noqa: E731 - as onnxruntime does
    monkeypatch.setattr(ort, "preload_dlls", tell, raising=False)
    write_model(models / "float", name="float")
    write_model(models / "int8", name="int8", float_model="float")
    built_with(monkeypatch, "cuda", "cpu")
    starting(monkeypatch, "cuda")
    loaded = SessionLoader("int8", threads=2).load()
    assert loaded._session.get_session_options().intra_op_num_threads == 2
    assert (loaded.model.card.name, loaded.provider) == ("int8", "cpu")
    assert loaded.warnings == ("provider 'cuda' does not start here, running on 'cpu'",)
    assert capsys.readouterr() == ("", missing)  # for outputs go to standard output
