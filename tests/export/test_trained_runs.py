"""Folders of training runs: found, read, and each exported once a checkpoint."""

import dataclasses
import json
from pathlib import Path

import pytest
from helpers.small import small_network, write_checkpoint

from depthcli.core.options import Weights
from depthcli.datasets.training_data import NYU_PAPER
from depthcli.errors import ParityError, UsageError
from depthcli.evaluation.task import group_by_seed
from depthcli.export import onnx as exporting
from depthcli.export.onnx import export_run, find_runs, open_run
from depthcli.models.catalog import find_model
from depthcli.training.checkpoint import Checkpoint
from depthcli.training.provenance import TrainedRun


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run that keeps an average."""
    folder = tmp_path / "runs" / "proposed-seed7"
    folder.mkdir(parents=True)
    ids = {"train_ids": ("0001", "0003"), "held_out_ids": ("0002",)}
    ids |= {"init_weights": "model.onnx 1234"}
    write_checkpoint(folder / "last.ckpt", average=small_network(seed=5), **ids)
    return folder


def test_a_run_is_what_its_checkpoint_says(folder: Path) -> None:
    config = dataclasses.replace(Checkpoint.load(folder / "last.ckpt").config, seed=0)
    assert open_run(folder) == TrainedRun(
        folder=folder,
        seed=7,
        settings=json.dumps(
            [
                dataclasses.asdict(config),
                [NYU_PAPER, ("0001", "0003"), ["", {}, ""], "model.onnx 1234"],
            ]
        ),
        paired=True,
        parameters=sum(weights.numel() for weights in small_network().parameters()),
        epochs=3,
        epochs_planned=config.optim.epochs,
        steps=12,
        minutes=1.5,
        train_ids=("0001", "0003"),
        held_out_ids=("0002",),
        nyu_ids=("0001", "0003"),
    )
    assert open_run(folder).name == "proposed-seed7"


@pytest.mark.parametrize(
    "other",
    [
        {"init_weights": "model.onnx 5678"},
        {"init_weights": ""},
        {"pseudo_labels": "9 pseudo labels (photos)"},
        {"pseudo_label_ids": {"own pairs (photos)": ("a1",)}},
        {"pseudo_label_fingerprint": "of the pseudo labels"},
        {"data": "own pairs (mine)"},
        {"train_ids": ("0001",)},
    ],
)
def test_runs_with_other_data_or_initial_weights_are_not_seeds_of_one_row(
    folder: Path, other: dict[str, object]
) -> None:
    saved = Checkpoint.load(folder / "last.ckpt").provenance
    known = {name: getattr(saved, name) for name in ("train_ids", "held_out_ids", "init_weights")}
    second = folder.with_name("proposed-seed8")
    for more, fits in (({"step": 1, "epoch": 0}, True), (other, False)):
        second.mkdir(exist_ok=True)
        write_checkpoint(second / "last.ckpt", **known | more)
        runs = [open_run(folder), dataclasses.replace(open_run(second), seed=8)]
        if fits:
            assert len(group_by_seed(runs)["proposed"]) == 2
        else:
            with pytest.raises(UsageError):
                group_by_seed(runs)


def test_runs_are_the_folder_itself_or_those_in_it(folder: Path) -> None:
    for name in ("b", "a"):
        (folder.parent / name).mkdir()
        (folder.parent / name / "last.ckpt").touch()
    (folder.parent / "notes").mkdir()
    assert [run.name for run in find_runs(folder.parent)] == ["a", "b", "proposed-seed7"]
    assert find_runs(folder) == (folder,)
    with pytest.raises(UsageError):
        find_runs(folder.parent / "notes")


def test_a_run_is_exported_once_a_checkpoint(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = open_run(folder)
    model = export_run(run, tmp_path)
    card = find_model(model).card
    assert (model, card.name) == (folder / "evaluated.onnx", run.name)
    made = model.stat().st_mtime_ns
    assert export_run(run, tmp_path).stat().st_mtime_ns == made
    model.write_bytes(b"torn")
    assert find_model(export_run(run, tmp_path)).card == card
    write_checkpoint(folder / "last.ckpt", small_network(seed=1))
    assert find_model(export_run(run, tmp_path)).card.version != card.version

    def refused(*_: object) -> None:
        raise ParityError("apart")

    monkeypatch.setattr(exporting, "export_checkpoint", refused)
    assert export_run(run, tmp_path) == model
    with pytest.raises(ParityError):
        export_run(run, tmp_path, Weights.RAW)


def test_a_run_whose_folder_is_full_is_exported_elsewhere(folder: Path, tmp_path: Path) -> None:
    (folder / "evaluated-raw.onnx").mkdir()
    model = export_run(open_run(folder), tmp_path / "spare", Weights.RAW)
    assert model == tmp_path / "spare" / "proposed-seed7" / "evaluated-raw.onnx"
    assert find_model(model).card.version.startswith("checkpoint-")
