"""Names of the outputs of videos and image sequences: no two inputs of a folder share one."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.requests import video_request

from depthcli.jobs.video.plan import plan_video, video_base
from depthcli.video.formats import VideoFormat


def write_names(folder: Path, names: str) -> None:
    for name in names.split():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()


@pytest.mark.parametrize(
    ("names", "bases"),
    [
        ("p.1001.exr p.1002.exr", {"p.%04d.exr": "p", "p.####.exr": "p", "p.%d.exr": "p"}),
        (
            "p.1001.exr p.1001.png p.mov",
            {"p.%04d.exr": "p.exr", "p.%04d.png": "p.png", "p.mov": "p.mov"},
        ),
        ("P.1001.exr p.mov", {"P.%04d.exr": "P.exr", "p.mov": "p.mov"}),
        ("p.1001.exr p.jpg", {"p.%04d.exr": "p.exr"}),
        ("p.1001_l.exr p.1001_r.exr", {"p.%04d_l.exr": "p_l", "p.%04d_r.exr": "p_r"}),
        ("1001.exr q.mov", {"%04d.exr": "sequence", "q.mov": "q"}),
        ("p/1001.exr p.mov", {"p": "p.exr", "p.mov": "p.mov"}),
        ("p/1001.exr p.1001.png", {"p": "p.exr", "p.%04d.png": "p.png"}),
        ("p/note.txt p.mov", {"p.mov": "p"}),
        ("p.mov p.depth.000001.png p.txt", {"p.mov": "p"}),
    ],
)
def test_shared_stems_keep_the_suffix(names: str, bases: dict[str, str], tmp_path: Path) -> None:
    write_names(tmp_path, names)
    assert {name: video_base(tmp_path / name) for name in bases} == bases


def test_own_outputs_do_not_count(inside: Cli) -> None:
    (inside.folder / "p").mkdir()
    for number in (1, 2):
        cv2.imwrite(str(inside.folder / "p" / f"{number}.png"), np.zeros((8, 8, 3), np.uint8))
    for out in ("q.%04d.png", "q/%04d.png"):
        assert inside("video", "p", "--out", out).returncode == 0
    assert video_base(inside.folder / "q.mov") == "q"


def test_every_output_has_the_name(tmp_path: Path) -> None:
    write_names(tmp_path, "p.1001.exr p.mov")
    formats = (VideoFormat.MKV, VideoFormat.PNG16)
    plan = plan_video(video_request(tmp_path / "p.####.exr", "out/", formats))
    assert list(plan.names.values()) == ["p.exr.depth.mkv", "p.exr.depth.%06d.png"]
