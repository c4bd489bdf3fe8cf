"""Give each command files that are not what they should be: each costs one line and an exit code.

    python -m robustness.bad_files [FAMILY...]

Nothing may be left behind or changed. What a line says is left to the tests, as are most of the
contents that a reader refuses; pictures have a table of their own, tests/helpers/bad_pictures.py.
"""

import copy
import io
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import h5py
import numpy as np
import onnx
import OpenEXR
import torch
from helpers.command_line import ROOT
from helpers.tiny import CARD, card_with, tiny_onnx
from onnx import TensorProto, helper

from robustness.fuzz import OF_LIBRARIES
from robustness.fuzz_targets import TARGETS, UNEXPECTED, checkpoint, flat_exr, mats, videos

Make = Callable[[Path], object] | bytes | str
_LONGEST_S = 120


class Family(NamedTuple):
    """A command that reads one kind of file.

    Attributes:
        file: its name, from the folder where the command runs.
        words: of the command.
        code: how it exits.
        good: a file, of which one half and one with a damaged end are given.
        more: what else can be wrong.
        may_leave: an output of what could be read.
    """

    file: str
    words: tuple[str, ...]
    code: int
    good: bytes
    more: dict[str, Make] = {}  # noqa: RUF012 - never changed
    may_leave: str = ""

    @property
    def table(self) -> dict[str, Make]:
        """All that is given to the command, by what is wrong with it."""
        return {
            "empty": b"",
            "text": "none of that",
            "zeros": bytes(9999),
            "half": self.good[: len(self.good) // 2],
            "a damaged end": self.good[:-40] + bytes(30),
            "a pipe": os.mkfifo,
            "a folder": Path.mkdir,
            **self.more,
        }


def _deep_exr(path: Path) -> None:
    samples = np.empty((4, 4), object)
    for pixel in np.ndindex(samples.shape):
        samples[pixel] = np.ones(2, np.float32)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    OpenEXR.File(header, dict.fromkeys("RGBZ", samples)).write(str(path))


_NPY, _EXR, _CHECKPOINT = TARGETS["npy"].seeds()[0], flat_exr(), checkpoint()
_MKV, _COLOUR, _MP4, _, _MJPEG, *_ = videos()
_VIDEOS: dict[str, Make] = {
    "a half MP4": _MP4[: len(_MP4) // 2],
    "a half AVI": _MJPEG[: len(_MJPEG) // 2],
    "a playlist": "#EXTM3U\n#EXTINF:1,\nb.mp4\n",
}


def _graph(outputs: list[Any], nodes: list[Any]) -> bytes:
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, ["n", 1, "h", "w"])
    graph = helper.make_graph(nodes, "g", [image], outputs)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"depthcli.card": json.dumps(CARD)})
    return model.SerializeToString()


def _constant(kind: int, shape: list[int], values: list[Any]) -> bytes:
    """A model whose output is always the same."""
    tensor = helper.make_tensor("c", kind, shape, values)
    node = helper.make_node("Constant", [], ["depth"], value=tensor)
    return _graph([helper.make_tensor_value_info("depth", kind, None)], [node])


def _no_input() -> bytes:
    model = onnx.load_from_string(_constant(TensorProto.FLOAT, [1, 1, 1], [1.0]))
    del model.graph.input[:]
    return model.SerializeToString()


def _more_depth_than_any_input() -> bytes:
    shape = helper.make_tensor("c", TensorProto.INT64, [3], [1, 5000, 4000])
    nodes = [
        helper.make_node("Constant", [], ["c"], value=shape),
        helper.make_node("ConstantOfShape", ["c"], ["depth"]),
    ]
    return _graph([helper.make_tensor_value_info("depth", TensorProto.FLOAT, None)], nodes)


def _sequence(kind: str, *inputs: str) -> bytes:
    depth = helper.make_tensor_sequence_value_info("depth", TensorProto.FLOAT, None)
    return _graph([depth], [helper.make_node(kind, inputs, ["depth"])])


def _deep_graph() -> bytes:
    graph = helper.make_graph([], "g", [], [])
    while graph.ByteSize() < 100_000:
        node = helper.make_node("If", ["c"], ["y"], then_branch=graph, else_branch=copy.copy(graph))
        graph = helper.make_graph([node], "g", [], [])
    return helper.make_model(graph).SerializeToString()


_MODELS: dict[str, Make] = {
    "a card of no metres": tiny_onnx(card=json.dumps(card_with({"output.min_m": None}))),
    "graphs in graphs": _deep_graph(),
    "no input": _no_input(),
    "no output": _graph([], [helper.make_node("Identity", ["image"], ["depth"])]),
    "a sequence": _sequence("SequenceConstruct", "image"),
    "an empty sequence": _sequence("SequenceEmpty"),
    "text for depth": _constant(TensorProto.STRING, [1, 1, 1], ["far"]),
    "empty depth": _constant(TensorProto.FLOAT, [1, 0, 0], []),
    "more depth than any input": _more_depth_than_any_input(),
    "one number": _constant(TensorProto.FLOAT, [], [1.0]),
    "complex numbers": _constant(TensorProto.COMPLEX64, [1, 1, 1], [1j]),
    "no depth": _constant(TensorProto.FLOAT, [1, 1, 1], [np.nan]),
}


def _checkpoint_with(**changes: Any) -> Make:
    content = torch.load(io.BytesIO(_CHECKPOINT), weights_only=True)
    return lambda path: torch.save(content | changes, path)


_CHECKPOINTS: dict[str, Make] = {
    "a pickle": b"cos\nsystem\n(S'touch harm'\ntR.",
    "weights that are not finite": _checkpoint_with(method={"a": torch.tensor(torch.nan)}),
    "another network": _CHECKPOINT,
}


def _mat(name: str, **options: Any) -> Make:
    """One of the file's arrays made anew."""

    def make(path: Path) -> None:
        path.write_bytes(mats()[0])
        with h5py.File(path, "r+") as file:
            del file[name]
            file.create_dataset(name, **options)

    return make


_HUGE = {"shape": (10**9, 3, 8, 6), "dtype": np.uint8, "chunks": (1, 3, 8, 6)}
_ELSEWHERE = {"shape": (2, 8, 6), "dtype": np.float32, "external": [("/etc/passwd", 0, 384)]}
_MATS = {
    "billions": _mat("images", **_HUGE),
    "words": _mat("depths", data=[b"a", b"b"]),
    "no metres": _mat("depths", data=np.full((2, 8, 6), 2e3, "f4")),
    "all nan": _mat("depths", data=np.full((2, 8, 6), np.nan, "f4")),
    "elsewhere": _mat("depths", **_ELSEWHERE),
    "scene names": _mat("scenes", data=[1, 2]),
}
_EXPORT = ("export-onnx", "a.ckpt", "-o", "b.onnx")
_PREDICT = ("predict", "good.png", "-o", "b.npy", "--model", "a.onnx")
_TRAIN = ("train", "proposed", "--data", "none", "--out", "run", "--config", "a.toml")
_VIDEO = ("video", "a.mkv", "--out", "b.mkv", "--quiet")
_PROFILE, _CONFIG, _CARD = b'[p]\nformat = "exr"\n', b"[data]\nzoom = 1.5\n", json.dumps(CARD)
FAMILIES = {
    "depth": Family("a.npy", ("info", "a.npy"), 1, _NPY),
    "exr": Family("a.exr", ("convert", "a.exr", "b.npy"), 1, _EXR, {"deep": _deep_exr}),
    "exr-picture": Family(
        "a.exr", ("predict", "a.exr"), 1, TARGETS["exr-picture"].seeds()[0], {"deep": _deep_exr}
    ),
    "depth-png": Family("a.png", ("probe", "a.png", "0,0"), 1, TARGETS["depth-png"].seeds()[0]),
    "video": Family("a.mkv", _VIDEO, 1, _COLOUR, _VIDEOS, may_leave="b.mkv"),
    "model": Family("a.onnx", _PREDICT, 3, tiny_onnx(card=_CARD), _MODELS),
    "card": Family("m/card.json", ("models", "show", "./m"), 3, _CARD.encode()),
    "profile": Family("depthcli.toml", ("predict", "good.png", "--profile", "p"), 2, _PROFILE),
    "configuration": Family("a.toml", _TRAIN, 2, _CONFIG),
    "checkpoint": Family("a.ckpt", _EXPORT, 3, _CHECKPOINT, _CHECKPOINTS),
    "mat": Family("a.mat", ("eval", "nyu", "--data", "a.mat"), 2, mats()[0], _MATS),
}
NOT_BAD = {("configuration", "a pipe"), ("checkpoint", "a pipe"), ("exr", "a folder")}
"""Pipes such as ``--config <(...)`` of a shell are waited for, and folders converted."""


def problems(family: Family, make: Make, folder: Path) -> Iterator[str]:
    """What a command did otherwise than it should, given a bad file of a family."""
    path = folder / family.file
    path.parent.mkdir(exist_ok=True)
    if callable(make):
        make(path)
    else:
        path.write_bytes(make.encode() if isinstance(make, str) else make)
    cv2.imwrite(str(folder / "good.png"), np.full((8, 8, 3), 99, np.uint8))
    before = _content(folder)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "depthcli", *family.words],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            check=False,
            timeout=_LONGEST_S,
        )
    except subprocess.TimeoutExpired:
        yield f"not done after {_LONGEST_S} s"
        return
    lines = [line for line in done.stderr.splitlines() if not OF_LIBRARIES.match(line)]
    said = [line.decode() for line in lines if not line.startswith(b"depthcli: warning: ")]
    if done.returncode != family.code:
        yield f"exit code {done.returncode}, not {family.code}"
    if len(said) != 1 or not said[0].startswith("depthcli: error: ") or not said[0].isprintable():
        yield f"not one line of error: {said}"
    elif UNEXPECTED.search(said[0]):
        yield said[0]
    after = _content(folder)
    after.pop(family.may_leave, None)
    if after != before:
        yield f"left or changed {sorted(name for name, _ in after.items() ^ before.items())}"


def _content(folder: Path) -> dict[str, bytes | None]:
    paths = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*")}
    return {name: path.read_bytes() if path.is_file() else None for name, path in paths.items()}


def main(names: Sequence[str]) -> int:
    """Try every bad file of the families, and print what went wrong."""
    count = short = 0
    for name in names or FAMILIES:
        for what, make in FAMILIES[name].table.items():
            if (name, what) in NOT_BAD:
                continue
            with tempfile.TemporaryDirectory(prefix="bad-") as folder:
                count += 1
                for problem in problems(FAMILIES[name], make, Path(folder)):
                    short += 1
                    print(f"{name}, {what}: {problem}", flush=True)
    print(f"{count} bad files, {short} fell short")
    return int(short > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
