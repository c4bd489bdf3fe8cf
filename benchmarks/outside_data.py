"""Depth of a plate that lacks a part of its display window, by what the network sees there.

python benchmarks/outside_data.py PHOTOGRAPHS --count 45

The mean relative change against the whole photograph, of the pixels that the plate has.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

import depthcli
from depthcli.core.types import Frame

SHARES = (0.02, 0.1, 0.5)  #: of the rows or columns, missing at one side
FILLS = {
    "black": cv2.BORDER_CONSTANT,
    "nearest": cv2.BORDER_REPLICATE,
    "mirrored": cv2.BORDER_REFLECT,
}


def changes(pipeline: depthcli.Pipeline, path: Path, share: float) -> list[list[float]]:
    """The change for each fill, of each side."""
    pixels = depthcli.read_image(path).pixels_8bit()
    height, width = pixels.shape[:2]
    rows, columns = round(share * height), round(share * width)
    whole = pipeline.predict(Frame(pixels)).depth.values
    found = []
    for sides in ((rows, 0, 0, 0), (0, rows, 0, 0), (0, 0, columns, 0), (0, 0, 0, columns)):
        top, bottom, left, right = sides
        data = slice(top, height - bottom), slice(left, width - right)
        plates = (cv2.copyMakeBorder(pixels[data], *sides, fill) for fill in FILLS.values())
        depths = [pipeline.predict(Frame(np.asarray(plate))).depth.values for plate in plates]
        found.append([float(np.mean(abs(depth[data] / whole[data] - 1))) for depth in depths])
    return found


def main() -> None:
    """Print the mean of all photographs and sides."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photographs", type=Path)
    parser.add_argument("--count", type=int, default=45)
    options = parser.parse_args()
    paths = sorted(options.photographs.iterdir())
    paths = paths[:: max(1, len(paths) // options.count)][: options.count]
    pipeline = depthcli.load_model("default", provider="cpu").pipeline
    for share in SHARES:
        means = np.mean([changes(pipeline, path, share) for path in paths], axis=(0, 1))
        print(
            f"{share:.0%}:",
            *(f"{fill} {mean:.3f}" for fill, mean in zip(FILLS, means, strict=True)),
        )


if __name__ == "__main__":
    main()
