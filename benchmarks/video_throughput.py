"""How near ``depthcli video`` comes to what the machine can do, on a video of 640×480 pixels.

The figure of merit is the share of the limit, where the limit is cores divided by the summed CPU
seconds of all stages of one frame, each measured alone. The whole process counts, with its start.
Run: ``python benchmarks/video_throughput.py [--frames 500] [--rounds 3]``
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import cv2
from tools import write_video

from depthcli.core.options import UpsamplingOptions
from depthcli.core.parallel import usable_cores
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.io.storage.atomic import Guard
from depthcli.jobs.video.known_depth import FrameAnchors
from depthcli.jobs.video.plan import VideoRequest, plan_video, video_destination
from depthcli.jobs.video.resume import FrameJournal
from depthcli.jobs.video.stages import FrameStages, open_output
from depthcli.video.formats import VideoFormat
from depthcli.video.source import VideoSource

if TYPE_CHECKING:
    from collections.abc import Callable

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")
FORMATS = (VideoFormat.MKV, VideoFormat.MP4)


class Stages:
    """CPU seconds of each stage over all frames."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def __call__(
        self,
        name: str,
        action: Callable[_Given, _Result],
        *given: _Given.args,
        **named: _Given.kwargs,
    ) -> _Result:
        """Measure one stage of one frame, with the threads that it starts."""
        start = time.process_time()
        result = action(*given, **named)
        self.seconds[name] = self.seconds.get(name, 0) + time.process_time() - start
        return result


def measure_stages(video: Path, folder: Path, frames: int) -> Stages:
    """CPU seconds of all stages of a frame, each in its turn, the mean over a few frames."""
    cv2.setNumThreads(1)
    pipeline = Pipeline(SessionLoader(threads=1).load(), UpsamplingOptions())
    plan = plan_video(VideoRequest(str(video), video_destination(f"{folder}/", FORMATS)))
    work = FrameStages(plan, pipeline, FrameJournal(), FrameAnchors(plan.settings))
    stages = Stages()
    with VideoSource(video) as source, ExitStack() as stack:
        outputs = {
            which: stack.enter_context(open_output(which, plan, source, Guard.of([video])))
            for which in FORMATS
        }
        taken = source.frames()
        work.predict(next(taken))
        for _ in range(frames):
            frame = stages("decode", next, taken)
            predicted = stages("predict", work.predict, frame)
            smoothed = stages("over time", next, work.smooth([predicted]))
            for which, output in outputs.items():
                part = stages(f"prepare {which}", output.encode, smoothed)
                stages(f"encode {which}", output.append, part)
        for which, output in outputs.items():
            stages(f"encode {which}", output.finish)
    for name in stages.seconds:
        stages.seconds[name] /= frames
    return stages


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    shares = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        video = write_video(folder / "room.avi", options.frames)
        for _ in range(options.rounds):
            stages = measure_stages(video, folder / "stages", min(100, options.frames - 1))
            start = time.perf_counter()
            command = (sys.executable, "-m", "depthcli", "video", str(video), "-o", f"{folder}/out")
            subprocess.run([*command, "--quiet"], check=True)
            rate = options.frames / (time.perf_counter() - start)
            shutil.rmtree(folder / "out")
            limit = usable_cores() / sum(stages.seconds.values())
            shares.append(rate / limit)
            print(f"limit {limit:.1f} frames/s  video {rate:.1f} frames/s")
    for name, seconds in stages.seconds.items():
        print(f"  {name:<12} {seconds * 1e3:6.2f} ms CPU")
    print(
        f"share of the limit {statistics.median(shares):.3f}  "
        f"({min(shares):.3f} to {max(shares):.3f})"
    )


if __name__ == "__main__":
    main()
