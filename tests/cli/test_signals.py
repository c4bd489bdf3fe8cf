"""Signals end a command at any moment, and leave nothing."""

import signal
import subprocess
import time
from pathlib import Path

import pytest
from helpers.command_line import ROOT, Cli
from helpers.tiny import write_model, write_picture
from onnx import TensorProto, helper

from depthcli.cli.process import ending_signals, graceful_shutdown
from robustness import killed


def endless_onnx() -> bytes:
    """A network that counts to 2^63 before it gives its input back."""
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["on"]),
            helper.make_node("Add", ["sum", "one"], ["next"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("i", TensorProto.INT64, []),
            helper.make_tensor_value_info("go", TensorProto.BOOL, []),
            helper.make_tensor_value_info("sum", TensorProto.FLOAT, None),
        ],
        [
            helper.make_tensor_value_info("on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("next", TensorProto.FLOAT, None),
        ],
        [helper.make_tensor("one", TensorProto.FLOAT, [], [1.0])],
    )
    graph = helper.make_graph(
        [helper.make_node("Loop", ["times", "true", "image"], ["depth"], body=body)],
        "endless",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, ["n", 1, "height", "width"])],
        [helper.make_tensor_value_info("depth", TensorProto.FLOAT, None)],
        [
            helper.make_tensor("times", TensorProto.INT64, [], [2**63 - 1]),
            helper.make_tensor("true", TensorProto.BOOL, [], [True]),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return model.SerializeToString()


ENDLESS_S = 3
"""More processor time than the start of a command takes: its network runs."""


def _processor_time_s(pid: int) -> int:
    shown = subprocess.run(["ps", "-o", "time=", "-p", str(pid)], capture_output=True, check=True)
    hours, minutes, seconds = map(int, shown.stdout.split(b":"))
    return hours * 3600 + minutes * 60 + seconds


@pytest.mark.parametrize("command", ["predict", "batch"])
def test_a_network_that_never_ends_does_not_outlive_ctrl_c(cli: Cli, command: str) -> None:
    write_model(cli.models / "default", endless_onnx())
    write_picture(cli.folder / "in" / "a.png")
    words = ("predict", "in/a.png", "-o", "out/") if command == "predict" else ("batch", "in")
    process = cli.started(*words, *(("--out", "out") if command == "batch" else ()))
    until = time.monotonic() + 60
    while time.monotonic() < until and _processor_time_s(process.pid) < ENDLESS_S:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 130
    assert b"resume" in said if command == "batch" else not said
    assert not list(cli.folder.glob("out/*.png"))


def test_signals_that_the_caller_ignores_stay_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # what nohup does
    try:
        assert signal.SIGHUP not in ending_signals()
        with graceful_shutdown(60.0, bool) as interrupt:
            signal.raise_signal(signal.SIGHUP)
            assert interrupt.number is None
            signal.raise_signal(signal.SIGTERM)
            assert interrupt.number == signal.SIGTERM
    finally:
        signal.signal(signal.SIGHUP, before)


def test_nothing_is_left_at_times_and_the_next_run_gives_the_same_bytes(tmp_path: Path) -> None:
    """A sample of the long command robustness/killed.py."""
    names = ("batch", "frames")
    killed.room(tmp_path, names)
    cli = Cli(ROOT, tmp_path, tmp_path / "models")
    assert killed.attack(cli, names, moments=3, seed=3, cold_every=1) == []
