"""A run as a program starts it, without a terminal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from helpers.rooms import EFFICIENT, write_rooms

from depthcli.errors import DatasetError, ModelError
from depthcli.jobs.train import TrainRequest, train
from depthcli.training.callbacks import Callback
from depthcli.training.checkpoint import Checkpoint

if TYPE_CHECKING:
    from depthcli.training.checkpoint import TrainState


class Notes(Callback):
    """Remembers what it is told."""

    def __init__(self) -> None:
        self.starts: list[tuple[bool, int]] = []
        self.epochs: list[int] = []

    def on_train_start(self, *, lacks_scenes: bool, seen_held_out: int) -> None:
        self.starts.append((lacks_scenes, seen_held_out))

    def on_epoch_end(self, state: TrainState) -> None:
        self.epochs.append(state.epoch)


def _request(folder: Path, **others: float) -> TrainRequest:
    return TrainRequest(
        EFFICIENT, folder / "data", folder / "run", accelerator="cpu", threads=1, **others
    )


def test_a_run_stops_goes_on_and_tells_of_it(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_rooms(tmp_path / "data")
    notes = Notes()
    stopped = train(_request(tmp_path, minutes=0), notes)
    assert (stopped.state.step, stopped.signal_number, stopped.is_global_zero) == (1, None, True)
    done = train(_request(tmp_path), notes)
    assert done.state == Checkpoint.load(tmp_path / "run" / "last.ckpt").state
    assert (done.state.step, notes.epochs) == (6, [1, 2, 3])
    assert [lacks_scenes for lacks_scenes, _ in notes.starts] == [False, False]
    assert capfd.readouterr() == ("", "")


def test_pairs_without_scenes_are_said_to_lack_them(tmp_path: Path) -> None:
    write_rooms(tmp_path / "data")
    (tmp_path / "data" / "index.csv").unlink()
    notes = Notes()
    train(_request(tmp_path, minutes=0), notes)
    assert [lacks_scenes for lacks_scenes, _ in notes.starts] == [True]


def test_held_out_pairs_that_the_initial_weights_were_trained_on_are_counted(
    tmp_path: Path,
) -> None:
    write_rooms(tmp_path / "data")
    request, notes = _request(tmp_path, minutes=0), Notes()
    config = replace(request.config, data=replace(request.config.data, holdout_every=0))
    first = replace(request, config=config, out=tmp_path / "first")
    train(first, notes)
    train(replace(request, init_weights=(first.out / "last.ckpt",)), notes)
    assert [seen for _, seen in notes.starts] == [0, 1]


@pytest.mark.parametrize(
    "changed",
    [{"units_per_metre": 256.0}, {"split": "official"}],
    ids=["unit is known", "no pair of the split"],
)
def test_settings_of_the_data_are_those_of_the_run(tmp_path: Path, changed: dict[str, Any]) -> None:
    index = write_rooms(tmp_path / "data") / "index.csv"
    index.write_text(index.read_text().replace(",train", ",test"))
    request = _request(tmp_path)
    config = replace(request.config, data=replace(request.config.data, **changed))
    with pytest.raises(DatasetError):
        train(replace(request, config=config), Notes())
    assert not request.out.exists()


def test_errors_are_raised_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(DatasetError):
        train(_request(tmp_path), Notes())
    assert not (tmp_path / "run").exists()


def test_an_unknown_model_to_start_from_is_told_before_the_data_set_is_opened(
    tmp_path: Path,
) -> None:
    request = replace(_request(tmp_path), init_weights=(Path("nope"),))
    with pytest.raises(ModelError):
        train(request, Callback())
