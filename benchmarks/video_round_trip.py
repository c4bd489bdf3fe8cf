"""Whether a depth video and numbered PNGs give back the same millimetres, frame for frame.

The figures are frames and pixels that differ between ``mkv``, ``png16`` and what ``predict`` gives
of the same frame, all 0, and the frame rates, which are those of the video, exactly. Run:
``python benchmarks/video_round_trip.py [--frames 100]``
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from tools import write_video

import depthcli
from depthcli.io.depth.read import read_stored_depth
from depthcli.video.depth_video import DepthVideo
from depthcli.video.source import VideoSource

_MILLIMETRES = 1000


def main() -> None:
    """Write both, read them back, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100)
    count = parser.parse_args().frames
    with tempfile.TemporaryDirectory() as name:
        video = write_video(Path(name) / "room.avi", count)
        out = Path(name) / "out"
        command = ("depthcli", "video", str(video), "--out", str(out), "--quiet")
        formats = ("--format", "mkv", "--format", "png16")
        subprocess.run([sys.executable, "-m", *command, *formats], check=True)
        stored, pngs = DepthVideo(out / "room.depth.mkv"), sorted(out.glob("*.png"))
        pipeline = depthcli.load_model(detail=depthcli.UpsamplingOptions()).pipeline
        frames = differing = 0
        with VideoSource(video) as source:
            print(f"frame rate {source.rate} of the video, {stored.rate} of mkv")
            for frame, steps, png in zip(source.frames(), stored.steps(), pngs, strict=True):
                from_png = np.rint(read_stored_depth(png).displayed.values * _MILLIMETRES)
                predicted = np.rint(pipeline.predict(frame).depth.values * _MILLIMETRES)
                differing += int(((steps != from_png) | (steps != predicted)).sum())
                frames += 1
    print(f"{frames} of {count} frames in both; {differing} pixels differ")
    sys.exit(bool(differing or frames != count))


if __name__ == "__main__":
    main()
