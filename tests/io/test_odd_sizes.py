"""A preview video of odd size: nothing is cut off, and what is added looks like its neighbours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from helpers.videos import NTSC

from depthcli.core.types import DepthMap, Frame
from depthcli.io.formats.preview import PreviewWriter
from depthcli.video.frames import Timing
from depthcli.video.outputs import DepthFrame, PreviewVideoOutput
from depthcli.video.source import VideoSource

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(("width", "height"), [(63, 48), (64, 47), (63, 47)])
def test_odd_rows_and_columns_are_doubled(width: int, height: int, tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    depth = DepthMap(np.full((height, width), 2, np.float32))
    writer = PreviewWriter(colormap="viridis")
    picture = np.zeros((height, width), np.uint8)
    with PreviewVideoOutput(path, Timing(NTSC), writer, None) as output:
        for time_s in (0, 1 / 30):
            shot = DepthFrame(Frame(picture, timestamp_s=time_s), depth, (1, 3))
            output.append(output.encode(shot))
        output.finish()
    with VideoSource(path) as source:
        frames = [frame.pixels.astype(int) for frame in source.frames()]
    colour = writer.render(depth, None, (1, 3))[0, 0].astype(int)
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 2
    assert max(np.abs(frame - colour).max() for frame in frames) < 16
