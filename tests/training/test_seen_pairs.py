"""What a network has seen is remembered, whatever its later training is of."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import onnx
import pytest
import torch
from helpers.supervised_runs import SUPERVISED, train_two_steps, write_extra

from depthcli.datasets.base import NYU
from depthcli.datasets.training_data import NYU_OFFICIAL, NYU_PAPER
from depthcli.errors import DatasetError
from depthcli.export.onnx import ExportOptions, export_checkpoint
from depthcli.export.trained import open_run
from depthcli.training.checkpoint import CHECKPOINT, TrainState
from depthcli.training.initial_weights import seen_by_files, seen_ids_X

if TYPE_CHECKING:
    from pathlib import Path

ALL = replace(SUPERVISED, data=replace(SUPERVISED.data, holdout_every=0))
SIX = tuple(f"{i:04d}" for i in range(6))
YARD = "own pairs (yard)"


@pytest.fixture
def start(tmp_path: Path) -> Path:
    """A checkpoint of a network that was trained on six pairs of NYU."""
    train_two_steps(ALL, tmp_path / "first", title=NYU_PAPER)
    return tmp_path / "first" / CHECKPOINT


@pytest.mark.parametrize("title", [NYU_PAPER, NYU_OFFICIAL, YARD])
def test_pairs_that_are_not_trained_on_again_are_remembered(
    tmp_path: Path, start: Path, title: str
) -> None:
    later = tmp_path / "later" / CHECKPOINT
    progress = train_two_steps(SUPERVISED, later.parent, start, title=title)
    assert progress.start_pairs == {NYU: SIX}
    assert "0002" in progress.held_out_ids
    model = later.with_name("model.onnx")
    card = export_checkpoint(later, model, ExportOptions("later")).card
    assert card.training["nyu_train_ids"] == "0000-0005"
    assert open_run(later.parent).nyu_ids == SIX
    for source in (later, model):
        assert seen_by_files([source])[NYU] == SIX


def test_a_chain_over_other_data_forgets_nothing(tmp_path: Path, start: Path) -> None:
    for title in (YARD, NYU_OFFICIAL, "own pairs (hall)"):
        folder = tmp_path / title
        train_two_steps(SUPERVISED, folder, start, title=title)
        start = folder / CHECKPOINT
    five = tuple(i for i in SIX if i != "0002")
    assert seen_by_files([start]) == {NYU: SIX, YARD: five, "own pairs (hall)": five}


def test_of_several_files_all_pairs_are_meant(tmp_path: Path, start: Path) -> None:
    train_two_steps(SUPERVISED, tmp_path / "yard", title=YARD)
    both = seen_by_files([start, tmp_path / "yard" / CHECKPOINT])
    assert (both[NYU], len(both[YARD])) == (SIX, 5)
    assert seen_by_files([]) == {}


@pytest.mark.parametrize(
    ("prefix", "nyu"), [("", SIX), ("photo-", tuple(i for i in SIX if i != "0002"))]
)
def test_extra_pairs_are_remembered(tmp_path: Path, prefix: str, nyu: tuple[str, ...]) -> None:
    """Also after a further training; those with numbers of NYU, as the rooms have, as its pairs."""
    extra = write_extra(tmp_path / "more", prefix)
    names = tuple(prefix + name for name in SIX)
    first, later = (tmp_path / name / CHECKPOINT for name in ("first", "later"))
    train_two_steps(SUPERVISED, first.parent, extra=extra, title=YARD)
    train_two_steps(SUPERVISED, later.parent, first, title=YARD)
    for file in (first, later):
        seen = seen_by_files([file])
        assert seen.pop(NYU, ()) == nyu
        assert seen["own pairs (more)"] == names
        assert seen.keys() == {"own pairs (more)", YARD}
        model = file.with_name("model.onnx")
        card = export_checkpoint(file, model, ExportOptions("model")).card
        assert card.training["nyu_train_ids"] == ("0000-0001,0003-0005" if prefix else "0000-0005")
        assert open_run(file.parent).nyu_ids == nyu


@pytest.mark.parametrize(("title", "name"), [(NYU_PAPER, NYU), (YARD, r"own pairs \(yard\)")])
def test_extra_pairs_that_the_run_holds_out_are_refused(
    tmp_path: Path, title: str, name: str
) -> None:
    extra, run = write_extra(tmp_path / "yard", prefix=""), tmp_path / "run"
    line = rf"contain 1 held-out pair of {name} \(first: 0002\): remove them from --pseudo-labels"
    with pytest.raises(DatasetError, match=line):
        train_two_steps(SUPERVISED, run, extra=extra, title=title)
    assert not run.exists()
    train_two_steps(ALL, run, extra=extra, title=title)


@pytest.mark.parametrize("zeros", ["", "0"])
def test_numbers_of_nyu_need_no_leading_zeros(tmp_path: Path, zeros: str) -> None:
    extra = write_extra(tmp_path / "more", prefix="")
    for file in [*extra.glob("*/*.png")]:
        file.rename(file.with_name(f"{zeros}{int(file.stem)}.png"))
    with pytest.raises(DatasetError, match=r"1 held-out pair of NYU .*first: 0002"):
        train_two_steps(SUPERVISED, tmp_path / "run", extra=extra, title=NYU_PAPER)
    train_two_steps(ALL, tmp_path / "run", extra=extra, title=YARD)
    assert seen_by_files([tmp_path / "run" / CHECKPOINT])[NYU] == SIX


def test_a_checkpoint_without_its_extra_pairs_gets_them_when_it_goes_on(tmp_path: Path) -> None:
    extra, run = write_extra(tmp_path / "more"), tmp_path / "run"
    train_two_steps(SUPERVISED, run, extra=extra)
    content = torch.load(run / CHECKPOINT, weights_only=True)
    del content["progress"]["pseudo_label_ids"]
    torch.save(content, run / CHECKPOINT)
    assert "own pairs (more)" not in seen_by_files([run / CHECKPOINT])
    assert train_two_steps(SUPERVISED, run, extra=extra).step == 4
    assert len(seen_by_files([run / CHECKPOINT])["own pairs (more)"]) == 6


def test_a_card_that_states_no_ids_is_no_error(start: Path) -> None:
    model = start.with_name("model.onnx")
    export_checkpoint(start, model, ExportOptions("first"))
    free = onnx.load(model)
    for entry in free.metadata_props:
        entry.value = entry.value.replace('"0000-0005"', '"all of them"')
    onnx.save(free, start.with_name("free.onnx"))
    assert seen_by_files([start.with_name("free.onnx")]) == {}


def test_checkpoints_before_0_10_tell_what_they_know() -> None:
    former = TrainState(train_ids=("0003",), start_ids=("0001",))
    assert seen_ids_X(former) == {NYU: ("0001", "0003")}
    assert seen_ids_X(replace(former, data=YARD)) == dict.fromkeys((YARD, NYU), ("0001", "0003"))


def test_a_folder_counts_as_nyu_if_all_its_names_are_numbers_of_nyu() -> None:
    def seen(*ids: str) -> set[str]:
        return seen_ids_X(TrainState(train_ids=ids, data=YARD)).keys()

    assert seen("0001", "1448") == {YARD, NYU}
    assert seen("0001", "1449") == seen("0001", "hall") == {YARD}
