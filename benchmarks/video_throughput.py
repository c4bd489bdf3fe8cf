"""How near ``depthcli video`` comes to what the machine can do, on a video of 640×480 pixels.

The figure of merit is the share of the limit, where the limit is cores divided by the summed CPU
seconds of all stages of one frame, each measured alone. The whole process counts, with its start.
Run: ``python benchmarks/video_throughput.py [--frames 500] [--rounds 3]``
"""

from __future__ import annotations

import shutil
import tempfile
from contextlib import ExitStack
from pathlib import Path

import cv2
import tools

from depthcli.core.options import UpsamplingOptions
from depthcli.core.parallel import usable_cores
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.io.guard import Guard
from depthcli.jobs.image import ImageJob
from depthcli.jobs.video.plan import VideoRequest, plan_video, video_destination
from depthcli.jobs.video.resume import FrameJournal
from depthcli.jobs.video.stages import FrameFilter, FramePredictor, open_output
from depthcli.known.sources import KnownDepthOfFrames
from depthcli.video.formats import VideoFormat
from depthcli.video.source import VideoSource

FORMATS = (VideoFormat.MKV, VideoFormat.MP4)


def measure_stages(video: Path, folder: Path, frames: int) -> dict[str, float]:
    """CPU seconds of all stages of a frame, each in its turn, the mean over a few frames."""
    cv2.setNumThreads(1)
    pipeline = Pipeline(SessionLoader(threads=1).load(), UpsamplingOptions())
    plan = plan_video(VideoRequest(str(video), video_destination(f"{folder}/", FORMATS)))
    known_depth, stages = KnownDepthOfFrames(plan.settings.anchors), tools.Stages()
    with VideoSource(video) as source, ExitStack() as stack:
        outputs = {
            format_: stack.enter_context(open_output(format_, plan, source, Guard.of([video])))
            for format_ in FORMATS
        }
        work = FramePredictor(
            ImageJob(pipeline), plan.settings, known_depth, FrameJournal(), source, 0, None
        )
        smoothing, decoded = FrameFilter(plan.settings, work.kind), source.frames()
        work.predict(next(decoded))
        for _ in range(frames):
            frame = stages("decode", next, decoded)
            predicted = stages("predict", work.predict, frame)
            smoothed = stages("over time", next, smoothing.smooth([predicted]))
            for format_, output in outputs.items():
                part = stages(f"prepare {format_}", output.encode, smoothed)
                stages(f"encode {format_}", output.append, part)
        for format_, output in outputs.items():
            stages(f"encode {format_}", output.finish)
    return stages.each_s(frames)


def main() -> None:
    """Measure and print."""
    options = tools.parse_options(__doc__, frames=500, rounds=3)
    limits, rates = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        video = tools.write_video(folder / "room.avi", options.frames)
        command = tools.process(
            "-m", "depthcli", "video", str(video), "-o", f"{folder}/out", "--quiet"
        )
        for _ in range(options.rounds):
            stages_s = measure_stages(video, folder / "stages", min(100, options.frames - 1))
            limits.append(usable_cores() / sum(stages_s.values()))
            rates.append(options.frames / tools.wall_s(command))
            shutil.rmtree(folder / "out")
            print(f"limit {limits[-1]:.1f} frames/s  video {rates[-1]:.1f} frames/s")
    tools.print_stages(stages_s)
    tools.print_spread("share of the limit", tools.ratios(rates, limits))


if __name__ == "__main__":
    main()
