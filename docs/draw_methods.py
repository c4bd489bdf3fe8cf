"""Draw what models and runs say of rooms that are rendered, as the paper's Fig. 2 and 3 do.

Run ``python docs/draw_methods.py docs/methods.jpg docs/results/generators/*-seed1``. Each column
after the room and its depth is one model, scaled to the median of the true depth; colours are
those of the true depth's span, and black is no depth.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import numpy.typing as npt

import depthcli
from depthcli.core.options import Colormap
from depthcli.datasets.rooms.render import TYPICAL_HFOV_DEG, Pair, RoomSettings, render_pair
from depthcli.export.onnx import export_run, open_run
from depthcli.io.formats.preview import colour_table, contact_sheet

_LEAST_M = 1e-3
SETTINGS = RoomSettings(seed=2, size=(192, 144), hfov_deg=(TYPICAL_HFOV_DEG, TYPICAL_HFOV_DEG))


def model_of(path: Path, spare: Path) -> depthcli.DepthModel:
    """A model by its path, or that of a training run."""
    if (path / "last.ckpt").is_file():
        path = export_run(open_run(path), spare)
    return depthcli.load_model(path, provider="cpu")


def coloured(
    depth_m: npt.NDArray[np.float32], span_m: npt.NDArray[np.float32]
) -> npt.NDArray[np.uint8]:
    """Near is bright, over the span of some other depth; 0 m is black."""
    near, far = np.quantile(1 / span_m[span_m > 0], (0.95, 0.02))
    nearness = np.clip((1 / np.maximum(depth_m, _LEAST_M) - far) / (near - far), 0, 1)
    nearness[depth_m <= 0] = 0
    table = colour_table(Colormap.INFERNO)
    return table[np.rint(nearness * 255).astype(np.uint8)]


def row(pair: Pair, models: list[depthcli.DepthModel]) -> list[npt.NDArray[np.uint8]]:
    """The room, its depth, and that of each model."""
    known = pair.depth_m > 0
    median_m = np.median(pair.depth_m[known])
    maps = [model.predict(pair.rgb, hfov_deg=TYPICAL_HFOV_DEG).values for model in models]
    scaled = [depth * (median_m / np.median(depth[known])) for depth in maps]
    return [pair.rgb, *(coloured(depth, pair.depth_m) for depth in (pair.depth_m, *scaled))]


def main() -> None:
    """Render rooms, predict them and write the sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path, help="picture to write")
    parser.add_argument("models", type=Path, nargs="+", help="runs of depthcli train, or models")
    parser.add_argument("--rooms", type=int, default=6)
    arguments = parser.parse_args()
    with TemporaryDirectory() as spare:
        models = [model_of(path, Path(spare)) for path in arguments.models]
    rows = [row(render_pair(SETTINGS, i), models) for i in range(arguments.rooms)]
    titles = ["room", "depth", *(re.sub(r"-seed\d+$", "", path.name) for path in arguments.models)]
    sheet = cv2.cvtColor(contact_sheet(rows, titles), cv2.COLOR_RGB2BGR)
    data = cv2.imencode(arguments.picture.suffix, sheet, (cv2.IMWRITE_JPEG_QUALITY, 88))[1]
    arguments.picture.write_bytes(data.tobytes())


if __name__ == "__main__":
    main()
