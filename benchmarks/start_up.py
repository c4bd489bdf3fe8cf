"""What the command line costs beyond what it does.

Two figures of merit, each a ratio of whole processes in one run:
``depthcli --help`` over ``python -c pass`` (at most 5), and ``depthcli predict`` of one 640×480
JPEG over a bare script that imports cv2 and onnxruntime, loads the same model, runs it once and
writes a PNG (at most 1.3).
Run: ``python benchmarks/start_up.py [--runs 15]``
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from tools import ROOM, alternate, parse_options, plain_script, process

from depthcli.models.catalog import find_model


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, runs=15)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "in").mkdir()
        shutil.copy(ROOM, folder / "in")
        bare = plain_script(find_model(), str(folder / "in"), str(folder / "bare"))
        out = str(folder / "depth.png")
        actions = {
            "python -c pass": process("-c", "pass"),
            "depthcli --help": process("-m", "depthcli", "--help"),
            "bare script": bare,
            "depthcli predict": process("-m", "depthcli", "predict", str(ROOM), "-o", out),
        }
        timings = alternate(list(actions.values()), options.runs)
    for number, (name, timing) in enumerate(zip(actions, timings, strict=True)):
        base = timings[number - number % 2]
        print(f"{name:17} {timing}   ratio {timing.median_s / base.median_s:.2f}")


if __name__ == "__main__":
    main()
