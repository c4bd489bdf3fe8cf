"""What the ways to full size cost.

Figures of merit: the milliseconds of the network, and of each way from pixels to depth, at 640×480
and at 4000×3000, timed in turn on one thread. What they do to edges and to accuracy, ``eval
--boundary --upsample`` and ``--tile`` say.
Run: ``python benchmarks/upsampling.py [--model default] [--runs 60]``
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np
from tools import HEIGHT, ROOM, WIDTH, alternate, parse_options

import depthcli
from depthcli.core.options import AUTO_TILE, Upsampling, UpsamplingOptions
from depthcli.core.types import Frame
from depthcli.inference.transforms import prepare

if TYPE_CHECKING:
    from collections.abc import Callable

    from depthcli.inference.session import Session

WAYS = {
    "bilinear": UpsamplingOptions(Upsampling.BILINEAR),
    "guided": UpsamplingOptions(Upsampling.GUIDED),
    "guided, tiles": UpsamplingOptions(Upsampling.GUIDED, AUTO_TILE),
}


def print_times(frame: Frame, session: Session, runs: int) -> None:
    """Print a line for each step and each way."""
    batch, _ = prepare(session.model.card.input, frame)
    actions: dict[str, Callable[[], object]] = {"network alone": lambda: session.run(batch)}
    for name, way in WAYS.items():
        actions[name] = partial(depthcli.Pipeline(session, way).predict, frame)
    print(f"\n{frame.width}×{frame.height}")
    timings = alternate(list(actions.values()), runs)
    for name, timing in zip(actions, timings, strict=True):
        ratio = timing.median_s / timings[0].median_s
        print(f"{name:26}{timing}  {ratio:.2f} × the network")


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, model="default", runs=60)
    session = depthcli.load_model(options.model, provider="cpu", threads=1).pipeline.session
    cv2.setNumThreads(1)
    room = depthcli.read_image(ROOM).pixels
    for size, runs in (((WIDTH, HEIGHT), options.runs), ((4000, 3000), max(5, options.runs // 6))):
        pixels = cv2.resize(room, size, interpolation=cv2.INTER_CUBIC).astype(np.uint8)
        print_times(Frame(pixels), session, runs)


if __name__ == "__main__":
    main()
