"""Everything of depthcli that reads a file from outside, each with good files to begin with."""

import contextlib
import dataclasses
import io
import json
import os
import re
from collections import deque
from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import cache
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import cv2
import h5py
import numpy as np
import pyarrow as pa
import torch
from helpers.command_line import ROOT, InProcess
from helpers.heifs import heic
from helpers.tiny import CARD, tiny_onnx, write_model
from helpers.videos import encode, flat_frames
from PIL import Image
from pyarrow import parquet

from depthcli.cli.parse import read_profiles
from depthcli.core.types import AnchorFit, DepthKind, DepthMap, Frame, Provenance, Window, Windows
from depthcli.errors import InputError
from depthcli.inference.pipeline import try_session
from depthcli.inference.session import Session
from depthcli.io.calibration import read_calibration, read_lenses
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.exr.file import read_exr_rate, write_exr
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.raster import Png16Writer, SidecarWriter
from depthcli.io.guard import is_own_image
from depthcli.io.images.png import encode_png
from depthcli.io.images.read import read_image
from depthcli.io.images.tiff import parse_exif
from depthcli.io.listing import column_texts, listed_inputs, parse_list
from depthcli.io.stored.depth import DepthReadOptions
from depthcli.jobs.video.resume import finished_frames
from depthcli.known.files import KnownDepthFiles
from depthcli.known.sources import read_known_depth
from depthcli.lab.datasets.folders import read_image_rgb, read_truth
from depthcli.lab.datasets.nyu import open_mat, read_index
from depthcli.lab.training.callbacks import truncate_log
from depthcli.lab.training.checkpoint import Checkpoint, TrainState
from depthcli.lab.training.config import TrainConfig
from depthcli.lab.training.settings import apply_overrides
from depthcli.models.card import ModelCard
from depthcli.models.catalog import find_model, onnx_facts
from depthcli.video.decoder import has_valid_slices
from depthcli.video.depth_video import DepthVideo
from depthcli.video.source import VideoSource

UNEXPECTED = re.compile(r"unexpected [A-Z]\w+:|Traceback")
_MAX_PIXELS = 2**22
_MAX_FRAMES = 50

_MM = DepthReadOptions(1000)


class Target(NamedTuple):
    """One reader."""

    file: str  #: name of the file that it is given, by which it may choose
    seeds: Callable[[], list[bytes]]  #: good files
    read: Callable[[Path], object]  #: takes the file's path
    share: float = 1  #: how many mutants it gets, by comparison


def _pixels() -> np.ndarray[Any, Any]:
    noise = np.random.default_rng(11).integers(0, 256, (40, 56, 3), np.uint8)
    return cv2.GaussianBlur(noise, (5, 5), 0)


def _saved(kind: str, mode: str = "RGB", **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(_pixels()).convert(mode).save(file, kind, **options)
    return file.getvalue()


def _exif() -> bytes:
    facts = Image.Exif()
    facts[0x0112] = 6
    facts.get_ifd(0x8769)[0xA405] = 28
    return facts.tobytes()


def _jpegs() -> list[bytes]:
    return [
        _saved("JPEG", exif=_exif()),
        _saved("JPEG", "L", progressive=True),
        _saved("JPEG", "CMYK", restart_marker_blocks=2),
    ]


def _pngs() -> list[bytes]:
    deep = cv2.imencode(".png", _pixels().astype(np.uint16) * 257)[1].tobytes()
    files = [_saved("PNG", mode) for mode in ("RGB", "RGBA", "P", "1", "LA")]
    return [_saved("PNG", exif=_exif(), icc_profile=b"none"), deep, *files]


def _tiffs() -> list[bytes]:
    codings = ("raw", "tiff_lzw", "tiff_adobe_deflate", "packbits", "jpeg")
    files = [_saved("TIFF", compression=coding) for coding in codings]
    deep = [
        cv2.imencode(".tiff", (_pixels() / 255).astype(kind))[1].tobytes()
        for kind in (np.float32, np.uint16)
    ]
    return [*files, *deep, _saved("TIFF", "1", compression="group4"), _saved("TIFF", big_tiff=True)]


def _webps() -> list[bytes]:
    return [_saved("WEBP"), _saved("WEBP", lossless=True), _saved("WEBP", "RGBA", exif=_exif())]


def _avifs() -> list[bytes]:
    file = io.BytesIO()
    first = Image.fromarray(_pixels())
    first.save(file, "AVIF", save_all=True, append_images=[first, first])
    return [_saved("AVIF", exif=_exif()), _saved("AVIF", "RGBA"), file.getvalue()]


def _heics() -> list[bytes]:
    colours = _pixels()
    deep = heic(colours.astype(np.uint16) * 257)
    files = [heic(colours, exif=_exif()), heic(colours, tile_size=64), heic(colours[..., 0])]
    return [*files, deep, heic(np.dstack([colours, colours[..., :1]])), heic(colours, colours)]


def _other_images() -> list[bytes]:
    files = [_saved("BMP", mode) for mode in ("RGB", "P", "1", "RGBA")]
    return [*files, _saved("GIF", "P"), _saved("PPM"), _saved("PPM", "L"), b"P2 2 2 9 1 2 3 4\n"]


def _depth() -> DepthMap:
    metres = np.linspace(0.5, 9, 24 * 32, dtype=np.float32).reshape(24, 32)
    return DepthMap(metres, DepthKind.METRIC, Provenance("tiny", "0" * 64, 500.0, 6))


def _written(
    writer: Any, name: str, depth: DepthMap | None = None, frame: Frame | None = None
) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        writer.write(depth or _depth(), path, frame)
        return path.read_bytes()


def _depth_pngs() -> list[bytes]:
    plain = cv2.imencode(".png", np.full((9, 9), 999, np.uint16))[1].tobytes()
    return [
        _written(Png16Writer(), "a.png"),
        _written(Png16Writer(png_normalize=True), "a.png"),
        plain,
    ]


def _exrs() -> list[bytes]:
    files = [_written(ExrWriter(), "a.exr"), _written(ExrWriter(half=True), "a.exr")]
    return [*files, *_plates()]


def _plates() -> list[bytes]:
    windows = Windows(Window(-4, 0, 9, 9), Window(-4, 2, 9, 9), Window(0, 0, 8, 8))
    pixels = np.zeros((9, 13), np.float32)
    frame = Frame(pixels, rate=Fraction(24), pixel_aspect=2.0, windows=windows)
    return [_written(ExrWriter(), "a.exr", DepthMap(pixels + 0.5), frame), _flat_exr()]


def _exr_images() -> list[bytes]:
    """Plates in colour and in gray."""
    light = {"R": np.linspace(0, 2, 104, dtype=np.float32).reshape(8, 13)}
    light |= {"G": light["R"] / 2, "B": np.flip(light["R"])}
    gray = {"Y": light["R"].astype(np.float16)}
    windows = Window(-4, 0, 9, 8), Window(0, 0, 8, 8)
    with TemporaryDirectory() as folder:
        path, files = Path(folder) / "a.exr", []
        for channels in (light, gray):
            write_exr(path, channels, {}, Fraction(24), pixel_aspect=2.0, windows=windows)
            files.append(path.read_bytes())
    return files


def _read_exr_image(path: Path) -> None:
    for frame in (
        read_image(path, max_pixels=_MAX_PIXELS),
        read_image(None, path.read_bytes(), max_pixels=_MAX_PIXELS),
    ):
        depth = DepthMap(np.zeros((frame.height, frame.width), np.float32))
        ExrWriter().write(depth, path.with_name("b.exr"), frame)
    read_exr_rate(path)


def _flat_exr() -> bytes:
    """One whose pixels are compressed."""
    flat = DepthMap(np.full((24, 32), 2, np.float32), DepthKind.METRIC)
    return _written(ExrWriter(), "a.exr", flat)


def _npys() -> list[bytes]:
    files = []
    for values in (_depth().values, _depth().values[None].astype(np.float64), np.zeros((3, 0))):
        file = io.BytesIO()
        np.save(file, values)
        files.append(file.getvalue())
    return files


def _sidecars() -> list[bytes]:
    facts = json.loads(
        """{"software": "depthcli 1.0.0", "unit": "metre", "scale": 1000, "kind": "metric",
        "orientation": 6, "model": "tiny", "focal_px": 500.0, "centre_px": [319.5, 239.5],
        "camera_source": "exif"}"""
    )
    facts["model_sha256"] = "0" * 64
    times_s = {"times_s": {"7": 0.25}}
    fitted = Provenance("tiny", "0" * 64, (256, 192), 500.0, anchor_fit=AnchorFit(3, 4, 0.1))
    of_a_image = _written(
        SidecarWriter(), "a.json", dataclasses.replace(_depth(), provenance=fitted)
    )
    return [json.dumps(facts).encode(), json.dumps(facts | times_s).encode(), of_a_image]


def _calibrations() -> list[bytes]:
    matrix = (
        b"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [431.5, 0, 3, 0, 431.5, 250.7, 0, 0, 1]\n"
    )
    more = b"D: [0.1, 0.0]\nP: [400, 0, 3, 0, 0, 400, 250, 0, 0, 0, 1, 0]\n---\n"
    files = [b"image_width: 640\nimage_height: 480\n" + matrix + more]
    for suffix in (".yml", ".xml", ".json"):
        file = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
        file.write("image_width", 640)
        file.write("image_height", 480)
        file.write("camera_matrix", np.array([[400.0, 0, 320], [0, 400, 240], [0, 0, 1]]))
        file.write("distortion_coefficients", np.zeros((1, 5)))
        files.append(file.releaseAndGetString().encode())
    return files


def _read_calibration(path: Path) -> None:
    with contextlib.suppress(InputError):
        read_calibration(path, rectified=True)
    read_calibration(path)


def _read_sidecar(path: Path) -> None:
    for array in (path.with_suffix(".npy"), path.with_name(f"{path.stem}.7.npy")):
        np.save(array, _depth().values)
        read_stored_depth(array)
        read_metadata(array)
    image = path.with_suffix(".png")
    image.write_bytes(encode_png((_depth().values * 1000).astype(np.uint16), {}))
    read_stored_depth(image)


def _cards() -> list[bytes]:
    return [json.dumps(CARD).encode()] + [
        path.read_bytes() for path in sorted((ROOT / "models").glob("*/card.json"))
    ]


def _models() -> list[bytes]:
    return [tiny_onnx(card=json.dumps(CARD)), tiny_onnx(stride=2, card=json.dumps(CARD))]


def _read_onnx(path: Path) -> None:
    onnx_facts(path)


def _run_model(path: Path) -> None:
    find_model(path)
    try_session(Session(find_model(path), provider="cpu"))


def _videos() -> list[bytes]:
    gray = [frame[..., 0].astype(np.uint16) * 200 for frame in flat_frames(range(60, 90, 10))]
    colour = [np.roll(_pixels(), by, 1) for by in range(3)]
    kinds: list[tuple[str, Any, str, str]] = [
        ("a.mkv", gray, "ffv1", "gray16le"),
        ("a.mkv", colour, "ffv1", "yuv420p"),
        ("a.mp4", colour, "mpeg4", "yuv420p"),
        ("b.mp4", colour, "libx264", "yuv420p"),
        ("a.avi", colour, "mjpeg", "yuvj444p"),
        ("b.avi", colour, "rawvideo", "bgr24"),
        ("a.webm", colour, "libvpx-vp9", "yuv420p"),
        ("a.mov", colour, "png", "rgb24"),
        ("a.ts", colour, "mpeg2video", "yuv420p"),
    ]
    with TemporaryDirectory() as folder:
        return [
            encode(Path(folder) / name, frames, Fraction(25), codec, form).read_bytes()
            for name, frames, codec, form in kinds
        ]


def _read_video(path: Path) -> None:
    with VideoSource(path, max_pixels=_MAX_PIXELS) as source:
        _take_frames(source.frames())


def _take_frames(frames: Iterable[object]) -> None:
    deque(islice(frames, _MAX_FRAMES), maxlen=0)


def _mats() -> list[bytes]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.mat"
        with h5py.File(path, "w") as file:
            file["images"] = np.full((2, 3, 8, 6), 99, np.uint8)
            file["depths"] = np.full((2, 8, 6), 2, np.float32)
            file.create_dataset("rawDepths", data=np.ones((2, 8, 6), np.float32), chunks=(1, 8, 6))
            file["names/a"] = np.frombuffer("kitchen".encode("utf-16-le"), np.uint16)
            names = [[file["names/a"].ref] * 2]
            file.create_dataset("scenes", data=np.array(names, h5py.ref_dtype))
        return [path.read_bytes()]


def _read_mat(path: Path) -> None:
    pairs = open_mat(path)
    with pairs.file:
        for i in range(min(2, len(pairs))):
            pairs.image(i), pairs.depth_m(i), pairs.raw_depth_m(i)


@cache
def _checkpoint() -> bytes:
    file = io.BytesIO()
    content = {
        "format": "depthcli-checkpoint",
        "version": 2,
        "config": dataclasses.asdict(TrainConfig()),
        "state": dataclasses.asdict(TrainState(3, 1, 2.5, {"abs_rel": 0.5})),
        "provenance": {},
        "method": {"generator.a": torch.ones(2, 2)},
        "ema_generator": {"a": torch.ones(2, 2)},
        "optimizers": {"generator": {"state": {0: {"step": torch.ones(())}}, "param_groups": []}},
        "extra": {"pool": [torch.ones(1, 2, 2)]},
        "rng": torch.get_rng_state()[:16].clone(),
        "device_rng": None,
        "precision": {},
        "others": [],
    }
    torch.save(content, file)
    return file.getvalue()


def _manifests() -> list[bytes]:
    row = json.loads(
        """{"status": "ok", "seconds": 0.5, "input_path": "/data/a.png", "error": null,
        "warnings": [], "camera": null, "model": "tiny", "version": "1.0.0"}"""
    )
    row["outputs"] = [{"path": "a.depth.png", "bytes": 9, "sha256": "0" * 64}]
    row |= dict.fromkeys(("input_sha256", "options_sha256", "model_sha256"), "0" * 64)
    lines = [json.dumps(row | {"input": name}) for name in ("a.png", "b.png", "c.mkv")]
    return ["".join(f"{line}\n" for line in lines).encode()]


def _path_tables() -> list[bytes]:
    """Lists of paths in Parquet, in other codings, too."""
    files = []
    names = [f"{number}/a.png" for number in range(40)]
    for options in ({}, {"compression": "none", "use_dictionary": False}, {"version": "1.0"}):
        file = io.BytesIO()
        parquet.write_table(pa.table({"path": names}), file, **options)
        files.append(file.getvalue())
    return files


def _batch(path: Path) -> None:
    """A batch beside the rows of an earlier one; a file of no row is another program's."""
    cli = InProcess(ROOT, path.parent, path.parent / "models")
    write_model(cli.models / "default")
    for folder in ("in", "out"):
        (path.parent / folder).mkdir()
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(path.parent / "in" / name), _pixels()[:8, :8])
    for name in ("manifest.jsonl", ".depthcli-batch.jsonl"):
        (path.parent / "out" / name).write_bytes(path.read_bytes())
        done = cli("batch", "in", "--out", "out", "--quiet")
        stderr = done.stderr.decode("utf-8", "surrogateescape")
        if UNEXPECTED.search(stderr) or done.returncode not in {0, 2}:
            raise RuntimeError(f"{done.returncode}: {stderr[:500]}")


def _read_journal(path: Path) -> None:
    finished_frames(path, "tiny")


def _image(path: Path) -> None:
    read_image(path, max_pixels=_MAX_PIXELS)


def _all_images() -> list[bytes]:
    makers = [_jpegs, _pngs, _tiffs, _webps, _avifs, _heics, _other_images]
    return [seed for seeds in makers for seed in seeds()]


def _exr_or_facts(path: Path) -> None:
    read_metadata(path)
    stored = read_stored_depth(path)
    ExrWriter().write(stored.depth, path.with_name("b.exr"), stored.frame)


TARGETS: dict[str, Target] = {
    "jpeg": Target("a.jpg", _jpegs, _image, 2),
    "png": Target("a.png", _pngs, _image, 2),
    "tiff": Target("a.tiff", _tiffs, _image, 2),
    "webp": Target("a.webp", _webps, _image),
    "avif": Target("a.avif", _avifs, _image, 2),
    "heic": Target("a.heic", _heics, _image, 2),
    "other-images": Target("a.bmp", _other_images, _image),
    "headers": Target("a.bin", _all_images, lambda path: parse_exif(path.read_bytes()), 4),
    "training-image": Target("a.png", _pngs, read_image_rgb),
    "training-depth": Target("a.png", _depth_pngs, lambda path: read_truth(path, _MM)),
    "own-png": Target("a.depth.png", _depth_pngs, is_own_image),
    "depth-png": Target("a.png", _depth_pngs, _exr_or_facts),
    "exr": Target("a.exr", _exrs, _exr_or_facts, 2),
    "exr-plate": Target("a.exr", _plates, _read_exr_image, 2),
    "exr-image": Target("a.exr", _exr_images, _read_exr_image, 2),
    "npy": Target("a.npy", _npys, _exr_or_facts, 2),
    "anchors": Target(
        "a.csv",
        lambda: [b"x,y,depth_m\n3,4,2.5\n20.4,7,1e1\n", b'depth_m,x,y,"a, b"\r\n2,3,4,"c"\r\n'],
        lambda path: read_known_depth(KnownDepthFiles(str(path))),
    ),
    "calibration": Target("a.yaml", _calibrations, _read_calibration, 2),
    "sidecar": Target("a.json", _sidecars, _read_sidecar),
    "card": Target("card.json", _cards, lambda path: ModelCard.from_json(path.read_bytes()), 2),
    "onnx": Target("a.onnx", _models, _read_onnx, 2),
    "model": Target("a.onnx", _models, _run_model, 2),
    "video": Target("a.mkv", _videos, _read_video, 3),
    "depth-video": Target(
        "a.mkv", lambda: _videos()[:1], lambda path: _take_frames(DepthVideo(path)), 2
    ),
    "ffv1-slices": Target(
        "a.bin", lambda: _videos()[:1], lambda path: has_valid_slices(path.read_bytes())
    ),
    "mat": Target("a.mat", _mats, _read_mat, 2),
    "index": Target(
        "index.csv",
        lambda: [b"id,scene,official_split\r\n0000,kitchen,test\r\n0001,study,train\r\n"],
        read_index,
    ),
    "cameras": Target(
        "cameras.csv", lambda: [b"id,focal_px,hfov_deg,cx,cy\na,30,,,\nb,,60,3.5,-2\n"], read_lenses
    ),
    "checkpoint": Target("a.ckpt", lambda: [_checkpoint()], Checkpoint.load),
    "metrics": Target(
        "metrics.jsonl",
        lambda: [b'{"epoch": 1, "step": 10, "scores": {"a": 1}}\n{"epoch": 2, "step": 20}\n'],
        lambda path: truncate_log(path, 10),
    ),
    "profile": Target("a.toml", lambda: [b'[fast]\nformat = ["exr"]\n'], read_profiles),
    "configuration": Target(
        "a.toml",
        lambda: [b"seed = 3\n[data]\nwidth = 64\nzoom = 1.5\n[optim]\nlearning_rate = 1e-4\n"],
        lambda path: apply_overrides(TrainConfig(), [path], []),
    ),
    "setting": Target(
        "a.txt",
        lambda: [b"optim.epochs_decay=3", b"data.width=64"],
        lambda path: apply_overrides(
            TrainConfig(), [], [path.read_text("utf-8", "surrogateescape")]
        ),
    ),
    "manifest": Target("manifest.jsonl", _manifests, _batch, 0.7),
    "frame-journal": Target(".a.depthcli-frames", lambda: [b'"tiny"\n0\n1\n2\n'], _read_journal),
    "parquet-list": Target("a.parquet", _path_tables, lambda path: [*column_texts(path, None)], 2),
    "list": Target(
        "a.txt",
        lambda: [b"a.png\nb/c.png\n", b"a.png\0b\nc.png\0"],
        lambda path: listed_inputs(parse_list(path.read_bytes()), os.fspath(path.parent)),
    ),
}
