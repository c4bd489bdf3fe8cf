"""What the command line costs beyond what it does.

Two figures of merit, each a ratio of whole processes in one run:
``depthcli --help`` over ``python -c pass`` (at most 5), and ``depthcli predict`` of one 640×480
JPEG over a bare script that imports cv2 and onnxruntime, loads the same model, runs it once and
writes a PNG (at most 1.3).
Run: ``python benchmarks/start_up.py``
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from tools import alternate, process

from depthcli.models.catalog import find_model

PICTURE = Path(__file__).parents[1] / "docs" / "room.jpg"
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
    model = find_model()
    size = (str(model.card.input.width), str(model.card.input.height))
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "depth.png")
        predict = process("-m", "depthcli", "predict", str(PICTURE), "-o", out)
        bare_out = str(Path(folder) / "bare.png")  # predict replaces no file of another program
        bare = process("-c", BARE, str(PICTURE), str(model.path), bare_out, *size)
        helped, nothing, predicted, scripted = alternate(
            [process("-m", "depthcli", "--help"), process("-c", "pass"), predict, bare], 15
        )
    print(f"python -c pass    {nothing}")
    print(f"depthcli --help   {helped}   ratio {helped.median_s / nothing.median_s:.2f}")
    print(f"bare script       {scripted}")
    print(f"depthcli predict  {predicted}   ratio {predicted.median_s / scripted.median_s:.2f}")


if __name__ == "__main__":
    main()
