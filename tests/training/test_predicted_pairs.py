"""``batch``, then ``train --pseudo-labels``: metres of any camera become those of one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from helpers.made import exif, jpeg_with_exif
from helpers.rooms import room_data
from helpers.tiny import write_model, write_picture

from depthcli.cli.app import main
from depthcli.datasets.folders import open_paired_folder
from depthcli.errors import DatasetError

if TYPE_CHECKING:
    from pathlib import Path

GRAY, SEEN_M = 128, 5 + 4 * (2 * 128 / 255 - 1)
"""A picture of one brightness, and what the tiny model sees in it at any size."""


@pytest.fixture
def more(tmp_path: Path) -> Path:
    """Pictures of three cameras, and their depth as predicted by ``batch``."""
    model = write_model(
        tmp_path / "model",
        camera={"hfov_deg": 63.3},
        input__fit="keep-aspect",
        input__width=192,
        input__height=144,
    )
    for name, (height, width) in {"room": (72, 96), "wide": (72, 128), "lens": (96, 72)}.items():
        picture = np.full((height, width, 3), GRAY, np.uint8)
        write_picture(tmp_path / "more" / "rgb" / f"{name}.jpg", picture)
    lens = tmp_path / "more" / "rgb" / "lens.jpg"
    lens.write_bytes(jpeg_with_exif(lens.read_bytes(), exif(focal_35mm=26)))
    words = ["batch", str(lens.parent), "--out", str(tmp_path / "more" / "depth"), "--quiet"]
    assert main([*words, "--format", "png16", "--upsample", "bilinear", "--model", str(model)]) == 0
    return tmp_path / "more"


def test_training_reads_what_the_model_saw(more: Path) -> None:
    """``batch`` multiplied it by the ratio of focal lengths, of which the network sees nothing."""
    pairs = open_paired_folder(more)
    data = room_data().with_pseudo_labels(pairs)
    assert data.pseudo_labels is not None
    assert pairs.ids == ("lens", "room", "wide")
    for i, ratio in enumerate((0.926, 1, 1.155)):
        # The input has whole pixels: up to a half percent from the ideal size.
        assert np.median(pairs.depth_m(i)) == pytest.approx(SEEN_M * ratio, rel=0.006)
        assert np.median(data.pseudo_labels.depth_m(i)) == pytest.approx(SEEN_M, rel=0.006)


def test_cameras_csv_comes_before_what_the_depth_states(more: Path) -> None:
    (more / "cameras.csv").write_text("id,focal_px\nlens,100\nroom,200\nwide,400\n")
    pairs = open_paired_folder(more)
    pseudo_labels = room_data().with_pseudo_labels(pairs).pseudo_labels
    assert pseudo_labels == pairs.for_camera(63.3, 4 / 3)


def test_depth_of_another_program_is_taken_as_it_is_but_not_beside_predictions(more: Path) -> None:
    names = ("lens", "room", "wide")
    for name in names:
        file = str(more / "depth" / f"{name}.depth.png")
        cv2.imwrite(file, cv2.imread(file, cv2.IMREAD_UNCHANGED))
        if name != names[-1]:
            with pytest.raises(DatasetError, match=r"lens\.depth\.png states no focal length"):
                room_data().with_pseudo_labels(open_paired_folder(more))
    assert room_data().with_pseudo_labels(
        open_paired_folder(more)
    ).pseudo_labels == open_paired_folder(more)
