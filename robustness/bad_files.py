"""Give each command files that are not what they should be: each costs one line and an exit code.

    python -m robustness.bad_files [FAMILY...]

Pictures have a table of their own, tests/helpers/bad_pictures.py.
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

from robustness.fuzz_targets import (
    checkpoint,
    depth_pngs,
    exr_pictures,
    flat_exr,
    mats,
    videos,
)

Make = Callable[[Path], None] | bytes | str


class Bad(NamedTuple):
    """A file or folder, and what the command says of it.

    Attributes:
        make: its content, or what writes it.
        line: a part of the one line on standard error.
        code: how the command exits.
    """

    make: Make
    line: str
    code: int = 1


class Family(NamedTuple):
    """Commands that read one kind of file.

    Attributes:
        file: its name, from the folder where the command runs.
        words: of the command.
        table: what can be wrong.
    """

    file: str
    words: tuple[str, ...]
    table: dict[str, Bad]


def write(make: Make, path: Path) -> None:
    """Make a bad file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if callable(make):
        make(path)
    else:
        path.write_bytes(make.encode("utf-8", "surrogatepass") if isinstance(make, str) else make)


def _fifo(path: Path) -> None:
    os.mkfifo(path)


def _png(pixels: Any) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def _npy(values: Any, **options: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, values, **options)
    return file.getvalue()


def _deep_exr(path: Path) -> None:
    samples = np.empty((4, 4), object)
    for pixel in np.ndindex(samples.shape):
        samples[pixel] = np.ones(2, np.float32)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    OpenEXR.File(header, dict.fromkeys("RGBZ", samples)).write(str(path))


_NPY = _npy(np.ones((4, 4), np.float32))
_EXR, _PNG16 = flat_exr(), depth_pngs()[0]
_EXR_PICTURE = exr_pictures()[0]
DEPTH = {
    "empty": Bad(b"", "a.npy is not a NumPy file that can be read"),
    "text": Bad("no depth", "a.npy is not a NumPy file that can be read"),
    "cut": Bad(_NPY[:-5], "a.npy is not a NumPy file that can be read"),
    "pickled": Bad(_npy(np.array([[None]]), allow_pickle=True), "is not a NumPy file that can be"),
    "words": Bad(_npy(np.array([["a"]])), "depth is one (H, W) array of numbers"),
    "complex": Bad(_npy(np.ones((2, 2), np.complex64)), "depth is one (H, W) array of numbers"),
    "a volume": Bad(_npy(np.ones((2, 3, 4))), "a.npy holds (2, 3, 4) float64; depth is one (H, W)"),
    "nothing": Bad(_npy(np.ones((0, 4))), "a.npy holds (0, 4) float64; depth is one (H, W)"),
    "a claim": Bad(_NPY.replace(b"(4, 4)", b"(9**9,)")[: len(_NPY)], "is not a NumPy file"),
    "a pipe": Bad(_fifo, "a.npy cannot be read: it is a pipe or a device"),
    "a folder": Bad(Path.mkdir, "a.npy is a folder"),
}
EXRS = {
    "empty": Bad(b"", "a.exr is not an EXR file that can be read"),
    "text": Bad("no depth", "a.exr is not an EXR file that can be read"),
    "head only": Bad(_EXR[:60], "a.exr is not an EXR file that can be read"),
    "cut": Bad(_EXR[:-4], "a.exr is damaged: its pixels cannot be read"),
    "damaged": Bad(_EXR[:-40] + bytes(40), "a.exr is damaged: its pixels cannot be read"),
    "a picture": Bad(_PNG16, "a.exr is not an EXR file that can be read"),
    "deep": Bad(_deep_exr, "a.exr holds deep data; flatten it first"),
}
EXR_PICTURES = {
    "empty": Bad(b"", "a.exr is empty"),
    "text": Bad("no picture", "a.exr is not an image"),
    "head only": Bad(_EXR_PICTURE[:60], "a.exr is not an EXR file that can be read"),
    "cut": Bad(_EXR_PICTURE[:-4], "a.exr is damaged: its pixels cannot be read"),
    "deep": Bad(_deep_exr, "a.exr holds deep data; flatten it first"),
    "depth": Bad(
        _EXR.replace(b"depthcli:software", b"anothers:software").replace(b"Y\0", b"Z\0"),
        "a.exr holds no image in R, G, B or Y; it has Z",
    ),
}
DEPTH_PNGS = {
    "colours": Bad(
        _png(np.zeros((4, 4, 3), np.uint16)), "is not 16-bit gray, so it holds no depth"
    ),
    "8 bits": Bad(_png(np.zeros((4, 4), np.uint8)), "is not 16-bit gray, so it holds no depth"),
    "cut": Bad(_PNG16[:-20], "is truncated (its end is missing)"),
    "checksum": Bad(_PNG16[:-17] + b"\0" + _PNG16[-16:], "a checksum of the PNG is wrong"),
    "an EXR": Bad(_EXR, "is an EXR; end its name in .exr, or save it as PNG or TIFF"),
}

_MKV, _COLOUR, _MP4, _, _MJPEG, *_ = videos()
VIDEOS = {
    "empty": Bad(b"", "a.mkv is empty"),
    "text": Bad("no video", "a.mkv holds no video that can be read"),
    "zeros": Bad(bytes(9999), "a.mkv holds no video that can be read"),
    "head only": Bad(_COLOUR[:300], "a.mkv holds no"),
    "cut": Bad(_COLOUR[:-2000], "a.mkv: it is truncated or damaged: it ends after"),
    "cut MP4": Bad(_MP4[: len(_MP4) // 2], "a.mkv holds no video that can be read"),
    "cut AVI": Bad(_MJPEG[: len(_MJPEG) // 2], "a.mkv holds no frame that can be decoded"),
    "a playlist": Bad("#EXTM3U\n#EXTINF:1,\nb.mp4\n", "a.mkv holds no video that can be read"),
    "a picture": Bad(_PNG16, "a.mkv holds no video that can be read"),
    "a pipe": Bad(_fifo, "a.mkv is a pipe or a device; "),
    "a folder": Bad(Path.mkdir, "a.mkv has no picture; see docs/video.md"),
}


def _card(**changes: Any) -> str:
    return json.dumps(card_with({name.replace("__", "."): v for name, v in changes.items()}))


def _graph(outputs: list[Any], nodes: list[Any], **options: Any) -> bytes:
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, ["n", 1, "h", "w"])
    graph = helper.make_graph(nodes, "g", [image], outputs, **options)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"depthcli.card": json.dumps(CARD)})
    return model.SerializeToString()


def _value(kind: int, shape: list[Any] | None = None) -> Any:
    return helper.make_tensor_value_info("depth", kind, shape)


def _constant(kind: int, shape: list[int], values: list[Any], name: str = "depth") -> Any:
    return helper.make_node(
        "Constant", [], [name], value=helper.make_tensor("c", kind, shape, values)
    )


def _no_input() -> bytes:
    model = onnx.load_from_string(
        _graph([_value(TensorProto.FLOAT)], [_constant(TensorProto.FLOAT, [1, 1, 1], [1.0])])
    )
    del model.graph.input[:]
    return model.SerializeToString()


def _external() -> bytes:
    model = onnx.load_from_string(tiny_onnx(card=json.dumps(CARD)))
    tensor = model.graph.initializer[0]
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")
    return model.SerializeToString()


def _deep_graph() -> bytes:
    graph = helper.make_graph([], "g", [], [])
    for _ in range(200):
        node = helper.make_node("If", ["c"], ["y"], then_branch=graph, else_branch=copy.copy(graph))
        graph = helper.make_graph([node], "g", [], [])
        if graph.ByteSize() > 100_000:
            break
    return helper.make_model(graph).SerializeToString()


_TINY = tiny_onnx(card=json.dumps(CARD))
_IDENTITY = helper.make_node("Identity", ["image"], ["depth"])
_SEQUENCE = helper.make_tensor_sequence_value_info("depth", TensorProto.FLOAT, None)
MODELS = {
    "empty": Bad(b"", "a.onnx is empty; download or export the model again", 3),
    "text": Bad("no model", "a.onnx is damaged or not an ONNX file", 3),
    "cut": Bad(_TINY[:-9], "a.onnx is damaged or not an ONNX file", 3),
    "no card": Bad(tiny_onnx(), "a.onnx has no card", 3),
    "card is no JSON": Bad(tiny_onnx(card="{"), "is not valid JSON", 3),
    "card of another schema": Bad(tiny_onnx(card=_card(schema=9)), "has schema 9", 3),
    "card of no metres": Bad(
        tiny_onnx(card=_card(output__min_m=None)), "output.min_m has to be", 3
    ),
    "weights elsewhere": Bad(_external(), "keeps weights in a second file", 3),
    "graphs in graphs": Bad(_deep_graph(), "a.onnx", 3),
    "no input": Bad(_no_input(), "a.onnx has the inputs none; export it with one float32 input", 3),
    "no output": Bad(_graph([], [_IDENTITY]), "a.onnx gives nothing, not numbers", 3),
    "a sequence": Bad(
        _graph([_SEQUENCE], [helper.make_node("SequenceConstruct", ["image"], ["depth"])]),
        "a.onnx gives seq(tensor(float)), not numbers; use a depth model",
        3,
    ),
    "an empty sequence": Bad(
        _graph([_SEQUENCE], [helper.make_node("SequenceEmpty", [], ["depth"])]),
        "a.onnx gives seq(tensor(float)), not numbers",
        3,
    ),
    "text for depth": Bad(
        _graph([_value(TensorProto.STRING)], [_constant(TensorProto.STRING, [1, 1, 1], ["far"])]),
        "a.onnx gives tensor(string), not numbers",
        3,
    ),
    "empty depth": Bad(
        _graph([_value(TensorProto.FLOAT)], [_constant(TensorProto.FLOAT, [1, 0, 0], [])]),
        "a.onnx gives (1, 0, 0), not one depth map a picture",
        3,
    ),
    "more depth than any input": Bad(
        _graph(
            [_value(TensorProto.FLOAT)],
            [
                _constant(TensorProto.INT64, [3], [1, 5000, 4000], "c"),
                helper.make_node("ConstantOfShape", ["c"], ["depth"]),
            ],
        ),
        "a.onnx gives (1, 5000, 4000), not one depth map a picture",
        3,
    ),
    "one number": Bad(
        _graph([_value(TensorProto.FLOAT)], [_constant(TensorProto.FLOAT, [], [1.0])]),
        "a.onnx gives (), not one depth map a picture",
        3,
    ),
    "complex numbers": Bad(
        _graph(
            [_value(TensorProto.COMPLEX64)], [_constant(TensorProto.COMPLEX64, [1, 1, 1], [1j])]
        ),
        "a.onnx",
        3,
    ),
    "no depth": Bad(
        _graph([_value(TensorProto.FLOAT)], [_constant(TensorProto.FLOAT, [1, 1, 1], [np.nan])]),
        "a.onnx gives no depth for good.png: not one number is finite",
        3,
    ),
}
CARDS = {
    "empty": Bad(b"", "card.json is empty", 3),
    "no text": Bad(b"\xff\xfe\0", "card.json: is not valid JSON", 3),
    "a list": Bad("[]", "card.json: has to be a JSON object, not []", 3),
    "a number": Bad("9" * 5000, "card.json: is not valid JSON", 3),
    "deep": Bad("[" * 100_000, "card.json: is not valid JSON (nested too deeply)", 3),
    "twice": Bad('{"schema": 1, "schema": 1}', "card.json: is not valid JSON (a name is there", 3),
    "no field": Bad('{"schema": 1}', "card.json: name is missing", 3),
    "a surrogate": Bad(_card(summary="\ud800"), "card.json: summary has to be at most 1000", 3),
    "control characters": Bad(_card(name="\x1b[2J"), "card.json: name has to be at most 1000", 3),
    "not a number": Bad(_card(output__scale=float("nan")), "output.scale has to be a number", 3),
    "infinite score": Bad(_card(scores={"a": float("inf")}), "scores.a has to be a finite", 3),
    "deep score": Bad(_card(scores={"a": json.loads("[" * 90 + "]" * 90)}), "nested too deep", 3),
    "no angle": Bad(_card(camera={"hfov_deg": 1e-9}), "camera.hfov_deg has to be an angle", 3),
    "wide angle": Bad(_card(camera={"hfov_deg": 179.999}), "camera.hfov_deg has to be an an", 3),
    "another file": Bad(_card(file="../model.onnx"), "file has to be a file name without a fo", 3),
    "surrogate": Bad(_card(file="\ud800.onnx"), "file has to be a file name without a fol", 3),
    "long name": Bad(_card(file="a" * 999), "file has to be a file name without a folder", 3),
    "no file": Bad(_card(file="none.onnx"), "cannot read", 3),
}
PROFILES = {
    "no TOML": Bad("format = ", "depthcli.toml is not TOML: ", 2),
    "no text": Bad(b"\xff\xfe", "depthcli.toml is not TOML: ", 2),
    "deep": Bad("a = " + "[" * 5000, "depthcli.toml is not TOML: ", 2),
    "a date": Bad("[p]\ntile = 1979-05-27\n", "--tile", 2),
    "unknown": Bad("[p]\nformats = 1\n", "no option named 'formats'", 2),
    "a word": Bad('[p]\nhfov = "wide"\n', "--hfov", 2),
    "no number": Bad("[p]\nhfov = nan\n", "--hfov", 2),
    "long number": Bad("[p]\nhfov = " + "9" * 5000, "depthcli.toml is not TOML: ", 2),
    "a control character": Bad('[p]\nformat = "\\u001b[2J"\n', "--format", 2),
    "a pipe": Bad(_fifo, "depthcli.toml is not TOML", 2),
}
CONFIGS = {
    "no TOML": Bad("seed = ", "a.toml is not TOML in UTF-8", 2),
    "no text": Bad(b"\xff\xfe", "a.toml is not TOML in UTF-8", 2),
    "deep": Bad("seed = " + "[" * 5000, "a.toml is not TOML in UTF-8", 2),
    "unknown": Bad("speed = 1\n", "a.toml: speed is unknown; choose from ", 2),
    "no group": Bad("optim = 1\n", "a.toml: optim has to be a group of ", 2),
    "a group": Bad("[seed]\na = 1\n", "a.toml: seed has to be a whole number", 2),
    "a word": Bad('[data]\nwidth = "wide"\n', "a.toml: data.width has to be a whole number", 2),
    "not a number": Bad(
        "[data]\nzoom = nan\n", "data.zoom has to be a number from 1 to 100, not nan", 2
    ),
    "large": Bad(
        f"seed = {2**70}\n",
        "seed has to be a whole number from 0 to 4294967295, not a number of",
        2,
    ),
    "a pipe": Bad(_fifo, "cannot read the configuration a.toml: it is a pipe", 2),
    "a folder": Bad(Path.mkdir, "cannot read the configuration a.toml: it is a folder", 2),
    "missing": Bad(lambda _: None, "cannot read the configuration a.toml: No such file", 2),
}


def _checkpoint(**changes: Any) -> Make:
    content = torch.load(io.BytesIO(checkpoint()), weights_only=True)
    return lambda path: torch.save(content | changes, path)


_WHOLE = checkpoint()
CHECKPOINTS = {
    "empty": Bad(b"", "a.ckpt is not a complete checkpoint", 3),
    "text": Bad("no checkpoint", "a.ckpt is not a complete checkpoint", 3),
    "cut": Bad(_WHOLE[: len(_WHOLE) // 2], "a.ckpt is not a complete checkpoint", 3),
    "pickle": Bad(b"cos\nsystem\n(S'touch harm'\ntR.", "a.ckpt is not a complete checkpoint", 3),
    "a pipe": Bad(_fifo, "a.ckpt is not a complete checkpoint", 3),
    "tensors": Bad(lambda path: torch.save({"a": torch.ones(2)}, path), "was not made by", 3),
    "version": Bad(_checkpoint(version=9), "a.ckpt was made by another version", 3),
    "configuration": Bad(_checkpoint(config={"speed": 1}), "speed is unknown", 3),
    "progress": Bad(_checkpoint(progress={"step": -1}), "step has to be a whole number from 0", 3),
    "field of view": Bad(_checkpoint(progress={"hfov_deg": -60.0}), "hfov_deg has to be an an", 3),
    "weights": Bad(_checkpoint(method={"a": torch.tensor(torch.nan)}), "numbers that are not f", 3),
    "pool": Bad(_checkpoint(extra={"pool": [3]}), "pool has to be a list of pictures", 3),
    "chance": Bad(_checkpoint(rng="dice"), "rng has to be the state of a generator", 3),
    "optimizer": Bad(_checkpoint(optimizers={"a": float("nan")}), "the optimizers holds", 3),
    "other network": Bad(_WHOLE, "a.ckpt does not fit its own configuration", 3),
}


def _mat(change: Callable[[Any], object]) -> Make:
    def make(path: Path) -> None:
        path.write_bytes(mats()[0])
        with h5py.File(path, "r+") as file:
            change(file)

    return make


def _again(name: str, *words: Any, **options: Any) -> Make:
    def change(file: Any) -> None:
        del file[name]
        file.create_dataset(name, *words, **options)

    return _mat(change)


_ELSEWHERE = {"shape": (2, 8, 6), "dtype": np.float32, "external": [("/etc/passwd", 0, 384)]}
_HUGE = {"shape": (10**9, 3, 8, 6), "dtype": np.uint8, "chunks": (1, 3, 8, 6)}
MATS = {
    "empty": Bad(b"", "a.mat is not a complete MATLAB v7.3 file", 2),
    "text": Bad("no matrix", "a.mat is not a complete MATLAB v7.3 file", 2),
    "cut": Bad(mats()[0][:-99], "a.mat is not a complete MATLAB v7.3 file", 2),
    "no pictures": Bad(_mat(lambda file: file.__delitem__("images")), "a.mat has no images", 2),
    "a group": Bad(
        _mat(lambda file: file.move("images", "x") or file.create_group("images")),
        "another kind of images",
        2,
    ),
    "billions": Bad(_again("images", **_HUGE), "a.mat holds images (1000000000, 3, 8, 6)", 2),
    "words": Bad(_again("depths", data=[b"a"]), "a.mat has another kind of depths", 2),
    "no metres": Bad(_again("depths", data=np.full((2, 8, 6), 2e3, "f4")), "check the unit", 2),
    "all nan": Bad(_again("depths", data=np.full((2, 8, 6), np.nan, "f4")), "check the unit", 2),
    "elsewhere": Bad(_again("depths", **_ELSEWHERE), "a.mat keeps depths in another file", 2),
    "scene names": Bad(_again("scenes", data=[1, 2]), "a.mat has another kind of scenes", 2),
}


def _folder(index: str) -> Make:
    def make(path: Path) -> None:
        for part in ("rgb", "depth"):
            (path / part).mkdir(parents=True)
        for name in ("0000", "0001"):
            cv2.imwrite(str(path / "rgb" / f"{name}.png"), np.full((8, 8, 3), 99, np.uint8))
            cv2.imwrite(str(path / "depth" / f"{name}.png"), np.full((8, 8), 2000, np.uint16))
        (path / "index.csv").write_text(index)

    return make


NYU = {
    "no index": Bad(_folder(""), "index.csv lacks the column id", 2),
    "other pairs": Bad(_folder("id,scene,official_split\n7,a,test\n"), "lists 1 pairs but the", 2),
    "twice": Bad(_folder("id,scene,official_split\n0,a,test\n0,a,test\n"), "1 ids more than o", 2),
    "split": Bad(_folder("id,scene,official_split\n0000,a,\x1b[2J\n"), "split '\\x1b[2J'", 2),
    "long field": Bad(_folder("id,scene,official_split\n" + "x" * 200_000), "is not CSV in UTF", 2),
}

_TRAIN = ("train", "proposed", "--data", "none", "--out", "run", "--config", "a.toml")
FAMILIES = {
    "depth": Family("a.npy", ("info", "a.npy"), DEPTH),
    "exr": Family("a.exr", ("convert", "a.exr", "b.npy"), EXRS),
    "exr-picture": Family("a.exr", ("predict", "a.exr"), EXR_PICTURES),
    "depth-png": Family("a.png", ("probe", "a.png", "0,0"), DEPTH_PNGS),
    "video": Family("a.mkv", ("video", "a.mkv", "--out", "b.mkv", "--quiet"), VIDEOS),
    "model": Family("a.onnx", ("predict", "good.png", "-o", "b.npy", "--model", "a.onnx"), MODELS),
    "card": Family("m/card.json", ("models", "show", "./m"), CARDS),
    "profile": Family("depthcli.toml", ("predict", "good.png", "--profile", "p"), PROFILES),
    "configuration": Family("a.toml", _TRAIN, CONFIGS),
    "checkpoint": Family("a.ckpt", ("export-onnx", "a.ckpt", "-o", "b.onnx"), CHECKPOINTS),
    "mat": Family("a.mat", ("eval", "nyu", "--data", "a.mat"), MATS),
    "nyu": Family("nyu", ("eval", "nyu", "--data", "nyu"), NYU),
}


def problems(family: str, name: str, folder: Path) -> Iterator[str]:
    """What a command did otherwise than it should, given a bad file of a family."""
    file, words, table = FAMILIES[family]
    bad = table[name]
    write(bad.make, folder / file)
    cv2.imwrite(str(folder / "good.png"), np.full((8, 8, 3), 99, np.uint8))
    before = {path.name for path in folder.iterdir()}
    done = subprocess.run(
        [sys.executable, "-m", "depthcli", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        check=False,
        timeout=120,
    )
    lines = done.stderr.decode().splitlines()
    errors = [line for line in lines if not line.startswith("depthcli: warning: ")]
    if done.returncode != bad.code:
        yield f"exit code {done.returncode}, not {bad.code}"
    if len(errors) != 1 or not errors[0].isprintable() or "unexpected " in errors[0]:
        yield f"not one line: {errors}"
    elif bad.line not in errors[0]:
        yield f"another line: {errors[0]}"
    left = {path.name for path in folder.iterdir()} - before - {"b.mkv"}  # whole frames
    if left:
        yield f"left {sorted(left)}"


def main(names: Sequence[str]) -> int:
    """Try every bad file of the families, and print what went wrong."""
    count = short = 0
    for family in names or FAMILIES:
        for name in FAMILIES[family].table:
            with tempfile.TemporaryDirectory(prefix="bad-") as folder:
                count += 1
                for problem in problems(family, name, Path(folder)):
                    short += 1
                    print(f"{family}, {name}: {problem}", flush=True)
    print(f"{count} bad files, {short} fell short")
    return int(short > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
