"""What writing one map costs: milliseconds and bytes of PNG and EXR, beside OpenCV's default PNG.

Figure of merit: time and size of depthcli over those of ``cv2.imencode`` with its defaults,
medians of alternating runs over all images; of EXR, over those of 32-bit floats with ZIP.
Run: ``python benchmarks/encoders.py [PICTURE ...] [--runs N]``
"""

from __future__ import annotations

import tempfile
import zlib
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

import cv2
import numpy as np
import OpenEXR
from tools import ROOM, alternate, parse_options

import depthcli
from depthcli.io.images import png
from depthcli.io.stored.metadata import metadata_texts, quantized

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

COMPRESSIONS = ("ZIP", "NO", "HTJ2K256")


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, rest=("images", [ROOM]), runs=15)
    pipeline = depthcli.load_model(provider="cpu").pipeline
    maps = [pipeline.predict(depthcli.read_image(path)).depth for path in options.images]
    texts = {f"depthcli:{name}": text for name, text in metadata_texts(maps[0]).items()}
    depths = [quantized(depth.values, 1000)[0] for depth in maps]
    print(f"{len(maps)} maps of the default model, the first {maps[0].width}×{maps[0].height}")
    pngs = {
        "OpenCV, its defaults": lambda pixels: cv2.imencode(".png", pixels)[1],
        "depthcli": partial(png.encode_png, texts=texts),
        "depthcli, zlib": partial(without_deflate, texts=texts),
    }
    show("16-bit PNG", pngs, depths, options.runs)
    with tempfile.TemporaryDirectory() as folder:
        exrs = {
            f"{kind.__name__} {name}": partial(in_exr, Path(folder) / "a.exr", kind, compression)
            for kind in (np.float32, np.float16)
            for name in COMPRESSIONS
            if (compression := getattr(OpenEXR, f"{name}_COMPRESSION", None)) is not None
        }
        show("EXR", exrs, [depth.values for depth in maps], options.runs)


def without_deflate(pixels: np.ndarray, texts: Mapping[str, str]) -> bytes:
    """As where the package ``deflate`` is not installed."""
    compress = partial(zlib.compress, level=1)
    with mock.patch.object(png, "_compressor", return_value=compress):
        return png.encode_png(pixels, texts)


def in_exr(path: Path, kind: type, compression: Any, values: np.ndarray) -> range:  # noqa: ANN401
    """An EXR file; a range as long as it stands for its bytes."""
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": values.astype(kind)}).write(str(path))
    size = path.stat().st_size
    path.unlink()  # replacing a file costs the system more than a new one
    return range(size)


def show(title: str, encoders: Mapping[str, Any], maps: Sequence[np.ndarray], runs: int) -> None:
    """Time every encoder in turn over all maps, and print a table, whose first row is the base."""

    def sizes(encode: Any) -> list[int]:  # noqa: ANN401
        return [len(encode(pixels)) for pixels in maps]

    timings = alternate([partial(sizes, encode) for encode in encoders.values()], runs)
    means = [np.mean(sizes(encode)) for encode in encoders.values()]
    print(f"\n{title:26}{'ms':>7}{'noise':>8}{'bytes':>10}{'time':>7}{'size':>7}")
    for name, timing, size in zip(encoders, timings, means, strict=True):
        print(
            f"{name:26}{timing.median_s / len(maps) * 1e3:7.2f}{timing.noise:8.0%}{size:10.0f}"
            f"{timing.median_s / timings[0].median_s:7.2f}{size / means[0]:7.2f}"
        )


if __name__ == "__main__":
    main()
