"""What writing one map costs: milliseconds and bytes of PNG and EXR, beside OpenCV's default PNG.

Figure of merit: time and size of ``encode_png`` over those of ``cv2.imencode`` with its defaults,
medians of alternating runs over all pictures. Encoders that are not installed are left out.
Run: ``python benchmarks/encoders.py [PICTURE ...] [--runs N] [--all]``
"""

from __future__ import annotations

import argparse
import importlib
import tempfile
import zlib
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
import OpenEXR
from tools import Timing, alternate

import depthcli
from depthcli.io.depth.metadata import metadata_texts, quantized
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.images.png import encode_png

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

PICTURE = Path(__file__).parents[1] / "docs" / "room.jpg"
BASELINE = "OpenCV, its defaults"
FILTERS = {"none": 0, "sub": 1, "up": 2, "average": 3}
EXR = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "HTJ2K256", "ZSTD")


class Row(NamedTuple):
    """One encoder over all maps."""

    name: str
    timing: Timing
    size: float


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pictures", nargs="*", type=Path, default=[PICTURE])
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--all", action="store_true", help="every filter, library and level")
    options = parser.parse_args()
    pipeline = depthcli.load_model(provider="cpu").pipeline
    maps = [pipeline.predict(depthcli.read_image(path)).depth for path in options.pictures]
    texts = {f"depthcli:{name}": text for name, text in metadata_texts(maps[0]).items()}
    depths = [quantized(depth.values, 1000)[0] for depth in maps]
    previews = [PreviewWriter().render(depth) for depth in maps]
    print(f"{len(maps)} maps of the default model, the first {maps[0].width}×{maps[0].height}")
    show("16-bit PNG", measure(png_encoders(texts, everything=options.all), depths, options.runs))
    show("preview PNG", measure(png_encoders({}, everything=options.all), previews, options.runs))
    values = [depth.values for depth in maps]
    with tempfile.TemporaryDirectory() as folder:
        encoders = exr_encoders(Path(folder) / "depth.exr")
        show("EXR", measure(encoders, values, options.runs), "float32 ZIP")


def png_encoders(texts: Mapping[str, str], *, everything: bool) -> dict[str, Any]:
    """Name -> function from pixels to something with a length."""
    up = (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP, cv2.IMWRITE_PNG_COMPRESSION)
    found: dict[str, Any] = {
        BASELINE: partial(in_opencv, options=()),
        "OpenCV, up, level 1": partial(in_opencv, options=(*up, 1)),
        "OpenCV, up, level 6": partial(in_opencv, options=(*up, 6)),
        "depthcli": partial(encode_png, texts=texts),
    }
    compressors = compressors_here(everything=everything)
    for filter_name in FILTERS if everything else ("up",):
        for name, compress in compressors.items():
            found[f"{name}, {filter_name}"] = partial(by_hand, FILTERS[filter_name], compress)
    return found


def compressors_here(*, everything: bool) -> dict[str, Callable[[np.ndarray], bytes]]:
    """Every library that is here, by name and level; each makes zlib streams."""
    libraries = {
        "zlib": ("zlib", "compress", (1, 6)),
        "libdeflate": ("deflate", "zlib_compress", (1, 2, 4, 6)),
        "isa-l": ("isal.isal_zlib", "compress", (1, 3)),
        "zlib-ng": ("zlib_ng.zlib_ng", "compress", (1, 2, 4)),
    }
    found = {}
    for name, (module, function, levels) in libraries.items():
        try:
            compress = getattr(importlib.import_module(module), function)
        except ImportError:
            continue
        for level in levels if everything else levels[:1]:
            found[f"{name} {level}"] = partial(_at_level, compress, level)
    if everything:
        for name, strategy in (("huffman", zlib.Z_HUFFMAN_ONLY), ("runs", zlib.Z_RLE)):
            found[f"zlib {name}"] = partial(_by_strategy, strategy)
    return found


def _at_level(compress: Any, level: int, data: np.ndarray) -> bytes:  # noqa: ANN401 - any library
    return compress(data, level)


def _by_strategy(strategy: int, data: np.ndarray) -> bytes:
    stream = zlib.compressobj(1, zlib.DEFLATED, 15, 9, strategy)
    return stream.compress(data) + stream.flush()


def in_opencv(pixels: np.ndarray, options: Sequence[int]) -> np.ndarray:
    """A PNG by OpenCV; the order of colours is no matter here."""
    return cv2.imencode(".png", pixels, options)[1]


def by_hand(number: int, compress: Callable[[np.ndarray], bytes], pixels: np.ndarray) -> bytes:
    """The compressed data of a PNG whose rows all have one filter."""
    step = pixels.itemsize * (1 if pixels.ndim == 2 else 3)
    rows = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(len(pixels), -1).view(np.uint8)
    framed = np.zeros((len(rows) + 1, rows.shape[1] + step), np.uint8)
    framed[1:, step:] = rows
    left, above = framed[1:, :-step], framed[:-1, step:]
    predicted = {
        0: lambda: np.uint8(0),
        1: lambda: left,
        2: lambda: above,
        3: lambda: (left & above) + ((left ^ above) >> 1),
    }[number]()
    filtered = np.full((len(rows), rows.shape[1] + 1), number, np.uint8)
    np.subtract(rows, predicted, out=filtered[:, 1:])
    return compress(filtered)


def exr_encoders(path: Path) -> dict[str, Any]:
    """Name -> function that writes a file and returns its content."""
    found = {}
    for kind in (np.float32, np.float16):
        for name in EXR:
            compression = getattr(OpenEXR, f"{name}_COMPRESSION", None)
            if compression is not None:
                found[f"{kind.__name__} {name}"] = partial(in_exr, path, kind, compression)
    return found


def in_exr(path: Path, kind: type, compression: Any, values: np.ndarray) -> range:  # noqa: ANN401
    """An EXR file; a range as long as it stands for its bytes."""
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": values.astype(kind)}).write(str(path))
    size = path.stat().st_size
    path.unlink()  # replacing a file costs the system more than a new one
    return range(size)


def measure(encoders: Mapping[str, Any], maps: Sequence[np.ndarray], runs: int) -> list[Row]:
    """Time every encoder in turn over all maps."""

    def over_all(encode: Any) -> None:  # noqa: ANN401
        for pixels in maps:
            encode(pixels)

    timings = alternate([partial(over_all, encode) for encode in encoders.values()], runs)
    rows = []
    for (name, encode), timing in zip(encoders.items(), timings, strict=True):
        seconds = tuple(total / len(maps) for total in timing.seconds)
        rows.append(Row(name, Timing(seconds), np.mean([len(encode(pixels)) for pixels in maps])))
    return rows


def show(title: str, rows: Sequence[Row], baseline: str = BASELINE) -> None:
    """A table, fastest first."""
    base = next(row for row in rows if row.name == baseline)
    print(f"\n{title:26}{'ms':>7}{'noise':>8}{'bytes':>10}{'time':>7}{'size':>7}  of {baseline}")
    for name, timing, size in sorted(rows, key=lambda row: row.timing.median_s):
        ratios = f"{timing.median_s / base.timing.median_s:7.2f}{size / base.size:7.2f}"
        print(f"{name:26}{timing.median_s * 1e3:7.2f}{timing.noise:8.0%}{size:10.0f}{ratios}")


if __name__ == "__main__":
    main()
