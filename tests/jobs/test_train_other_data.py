"""A run is not continued on other data than it began with."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
from helpers.rooms import EFFICIENT, write_rooms

from depthcli.errors import CheckpointError
from depthcli.jobs.train import TrainRequest, train
from depthcli.training.callbacks import Callback
from depthcli.training.checkpoint import CHECKPOINT, Checkpoint

CAMERAS = "id,focal_px\n" + "".join(f"room{i:04d},60\n" for i in range(6))


@pytest.fixture
def request_of(tmp_path: Path) -> TrainRequest:
    """Six rooms under names of their own, of which one is held out, after one step."""
    mine = write_rooms(tmp_path / "mine")
    for file in [*mine.glob("*/*.png")]:
        file.rename(file.with_name(f"room{file.name}"))
    index = mine / "index.csv"
    index.write_text(index.read_text().replace("\n0", "\nroom0"))
    run = tmp_path / "run"
    request = TrainRequest(EFFICIENT, mine, run, accelerator="cpu", threads=1, minutes=0)
    train(request, Callback())
    assert Checkpoint.load(run / CHECKPOINT).provenance.held_out_ids == ("room0002",)
    return request


def _add_camera(folder: Path) -> None:
    (folder / "cameras.csv").write_text(CAMERAS)


def _add_held_out(folder: Path) -> None:
    for part in ("rgb", "depth"):
        shutil.copy(folder / part / "room0002.png", folder / part / "room0006.png")
    with (folder / "index.csv").open("a") as index:
        index.write("room0006,den_1,train\n")


def _paint(folder: Path) -> None:
    file = str(next(folder.glob("rgb/*0000.png")))
    cv2.imwrite(file, cv2.imread(file) // 2)


@pytest.mark.parametrize("change", [_add_camera, _add_held_out, _paint])
def test_changed_data_are_refused(request_of: TrainRequest, change: Callable[[Path], None]) -> None:
    change(request_of.data)
    with pytest.raises(CheckpointError):
        train(request_of, Callback())


def test_other_focal_lengths_are_refused(request_of: TrainRequest) -> None:
    _add_camera(request_of.data)
    request = replace(request_of, out=request_of.out.with_name("scaled"))
    train(request, Callback())
    (request.data / "cameras.csv").write_text(CAMERAS.replace(",60", ",80"))
    with pytest.raises(CheckpointError):
        train(request, Callback())


def test_folder_of_the_data_may_have_moved(request_of: TrainRequest) -> None:
    moved = replace(request_of, data=request_of.data.rename(request_of.data.with_name("moved")))
    assert train(moved, Callback()).state.step == 2
