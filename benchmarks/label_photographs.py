"""Label photographs with a model's depth and that of other networks, for ``--pseudo-labels``.

The mean of log depth of a photograph and its mirror, at each width; ``--labels`` adds images of 8
bits with 0.2 · 60^(value ÷ 255) metres, two thirds of the mean, and leaves a photograph out if the
two differ by more than .12 (mean |difference of logs| without that of the medians).
Run: ``python benchmarks/label_photographs.py PHOTOS OUT --model A [--labels DIR]``
It goes on where it stopped: a photograph that has a label is skipped.
"""

import csv
from pathlib import Path

import cv2
import numpy as np
from aspect_ratios import resized
from tools import parse_options

import depthcli

FOCAL_PX = 207.66  # of NYU Depth v2 at 256 pixels across, which photographs are taken to have
WEIGHT, MOST_DIFFERENCE = 2 / 3, 0.12


def main() -> None:
    """Write photographs, their labels, and the focal length of each."""
    options = parse_options(__doc__, "photos", "out", model=str, labels=Path, widths=[192, 224])
    plain = depthcli.UpsamplingOptions(upsampling="bilinear")
    model = depthcli.load_model(options.model, provider="cpu", threads=1, detail=plain).pipeline
    scales = [width / model.card.input.width for width in options.widths]
    teachers = [(resized(model, scale), scale) for scale in scales]
    rgb, depth = (options.out / kind / "p" for kind in ("rgb", "depth"))
    for folder in (rgb, depth):
        folder.mkdir(parents=True, exist_ok=True)
    for photo in sorted(options.photos.glob("*.jpg")):
        label = depth / f"{photo.stem}.png"
        if label.exists():
            continue
        pixels = depthcli.read_image(photo).pixels
        views = [depthcli.Frame(np.ascontiguousarray(pixels[:, ::side])) for side in (1, -1)]
        depths_m = [
            teacher.predict(view).depth.values[:, ::side] * scale
            for teacher, scale in teachers
            for view, side in zip(views, (1, -1), strict=True)
        ]
        log_depth = np.log(depths_m).mean(axis=0)
        if options.labels is not None:
            stored = cv2.imread(next(options.labels.glob(f"{photo.stem}.*")), cv2.IMREAD_GRAYSCALE)
            enlarged = cv2.resize(stored.astype(np.float32), log_depth.shape[::-1])
            difference = np.log(0.2) + enlarged * (np.log(60) / 255) - log_depth
            if np.abs(difference - np.median(difference)).mean() > MOST_DIFFERENCE:
                continue
            log_depth += WEIGHT * difference
        (rgb / photo.name).write_bytes(photo.read_bytes())
        cv2.imwrite(label, np.rint(np.exp(log_depth) * 1000).astype(np.uint16))
    rows = [(f"p/{path.stem}", FOCAL_PX) for path in sorted(rgb.iterdir())]
    with (options.out / "cameras.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("id", "focal_px"), *rows])


if __name__ == "__main__":
    main()
