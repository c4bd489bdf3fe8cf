"""What the command line costs beyond what it does.

Two figures of merit, each a ratio of whole processes in one run:
``depthcli --help`` over ``python -c pass`` (at most 5), and ``depthcli predict`` of one 640×480
JPEG over a bare script that imports cv2 and onnxruntime, loads the same model, runs it once and
writes a PNG (at most 1.3).
Run: ``python benchmarks/start_up.py [--runs 15]``
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from tools import ROOM, alternate, parse_options, process

from depthcli.models.catalog import find_model

BARE = """
import sys, cv2, numpy as np, onnxruntime
picture, model, out, width, height = sys.argv[1:]
image = cv2.imread(picture)
gray = cv2.resize(image.max(axis=2), (int(width), int(height)), interpolation=cv2.INTER_AREA)
session = onnxruntime.InferenceSession(model)
batch = (gray.astype(np.float32) / 127.5 - 1)[None, None]
raw = session.run(None, {session.get_inputs()[0].name: batch})[0][0, 0]
depth = cv2.resize(np.exp(raw), image.shape[1::-1])
cv2.imwrite(out, (depth * 1000).astype(np.uint16))
"""


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, runs=15)
    model = find_model()
    size = (str(model.card.input.width), str(model.card.input.height))
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "depth.png")
        bare_out = str(Path(folder) / "bare.png")  # predict replaces no file of another program
        actions = {
            "python -c pass": process("-c", "pass"),
            "depthcli --help": process("-m", "depthcli", "--help"),
            "bare script": process("-c", BARE, str(ROOM), str(model.path), bare_out, *size),
            "depthcli predict": process("-m", "depthcli", "predict", str(ROOM), "-o", out),
        }
        timings = alternate(list(actions.values()), options.runs)
    for number, (name, timing) in enumerate(zip(actions, timings, strict=True)):
        base = timings[number - number % 2]
        print(f"{name:17} {timing}   ratio {timing.median_s / base.median_s:.2f}")


if __name__ == "__main__":
    main()
