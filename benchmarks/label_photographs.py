"""Label photographs with the mean of several models, as pairs for ``train --pseudo-labels``.

Each model sees a photograph and its mirror at each width; the mean is of log depth. ``--labels``
adds depth of other networks to it, images of 8 bits with 0.2 · 60^(value ÷ 255) metres; then a
photograph is left out if its depth differs by more than ``--most-difference`` (mean |difference of
logs| after removing that of the medians).
Run: ``python benchmarks/label_photographs.py PHOTOS OUT --model A [B ...] [--labels DIR]``
It goes on where it stopped: a photograph that has a label is skipped.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from aspect_ratios import resized
from tools import parse_options

import depthcli

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

FOCAL_PX = 207.66
"""Of NYU Depth v2 at 256 pixels across, which the photographs are taken to have."""
MM_PER_M = 1000


class Teacher(NamedTuple):
    """A model at one size of its input.

    Attributes:
        pipeline: the model.
        scale: that width ÷ the model's own: things look larger by it, thus nearer.
    """

    pipeline: depthcli.Pipeline
    scale: float

    def log_depth(self, pixels: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        """Mean of log metres (H, W) of a picture (H, W, 3) and its mirror."""
        seen_m = [
            self.pipeline.predict(
                depthcli.Frame(np.ascontiguousarray(pixels[:, ::side]))
            ).depth.values
            for side in (1, -1)
        ]
        return np.log([seen_m[0] * self.scale, seen_m[1][:, ::-1] * self.scale]).mean(axis=0)


class Others(NamedTuple):
    """Stored depth of other networks.

    Attributes:
        folder: images of 8 bits, named like the photographs.
        weight: share in the mean.
        most_difference: of the shape of depth, above which a photograph is left out.
    """

    folder: Path
    weight: float
    most_difference: float

    def mean(self, name: str, log_depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32] | None:
        """Weighted mean with the stored depth, or None if the two differ too much."""
        stored = cv2.imread(str(next(self.folder.glob(f"{name}.*"))), cv2.IMREAD_GRAYSCALE)
        theirs = np.log(0.2) + cv2.resize(stored.astype(np.float32), log_depth.shape[::-1]) * (
            np.log(60) / 255
        )
        apart = theirs - log_depth
        if np.abs(apart - np.median(apart)).mean() > self.most_difference:
            return None
        return log_depth + self.weight * apart


def label_photographs(
    photos: Sequence[Path], out: Path, teachers: Sequence[Teacher], others: Others | None
) -> None:
    """Write the photographs and their labels, those that have none yet."""
    for kind in ("rgb", "depth"):
        (out / kind / "p").mkdir(parents=True, exist_ok=True)
    for photo in photos:
        labelled = out / "depth" / "p" / f"{photo.stem}.png"
        if not labelled.exists():
            pixels = depthcli.read_image(photo).pixels
            log_depth = np.mean([teacher.log_depth(pixels) for teacher in teachers], axis=0)
            if others is not None:
                log_depth = others.mean(photo.stem, log_depth)
            if log_depth is not None:
                (out / "rgb" / "p" / photo.name).write_bytes(photo.read_bytes())
                depth_mm = np.exp(log_depth) * MM_PER_M
                cv2.imwrite(str(labelled), np.rint(depth_mm).astype(np.uint16))


def main() -> None:
    """Label, and write the focal length of each picture."""
    options = parse_options(
        __doc__,
        "photos",
        "out",
        model=["default"],
        labels=Path,
        labels_weight=2 / 3,
        most_difference=0.12,
        widths=[192, 224],
        part=[0, 1],
    )
    plain = depthcli.UpsamplingOptions(upsampling="bilinear")
    models = [
        depthcli.load_model(model, provider="cpu", threads=1, detail=plain).pipeline
        for model in options.model
    ]
    scales = [width / models[0].card.input.width for width in options.widths]
    teachers = [Teacher(resized(model, scale), scale) for model in models for scale in scales]
    others = None
    if options.labels is not None:
        others = Others(options.labels, options.labels_weight, options.most_difference)
    part, parts = options.part
    photos = sorted(options.photos.glob("*.jpg"))[part::parts]
    label_photographs(photos, options.out, teachers, others)
    rows = [(f"p/{path.stem}", FOCAL_PX) for path in sorted((options.out / "rgb/p").iterdir())]
    with (options.out / "cameras.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("id", "focal_px"), *rows])


if __name__ == "__main__":
    main()
