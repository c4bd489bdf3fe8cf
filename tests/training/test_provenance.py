"""Provenance: runs are compared by their data, and every pair ever trained on is recorded."""

from dataclasses import replace
from pathlib import Path

import onnx
import pytest
from helpers.supervised_runs import SUPERVISED, train_two_steps, write_pseudo_labels

from depthcli.datasets.base import NYU
from depthcli.datasets.training_data import NYU_OFFICIAL, NYU_PAPER
from depthcli.errors import CheckpointError, DatasetError, UsageError
from depthcli.export.onnx import ExportOptions, export_checkpoint, open_run
from depthcli.models.catalog import find_model
from depthcli.training.checkpoint import CHECKPOINT, Checkpoint, saved_checkpoint
from depthcli.training.config import TrainConfig
from depthcli.training.methods.registry import default_config
from depthcli.training.provenance import (
    DataProvenance,
    PairIds,
    config_differences,
    data_differences,
    ids_of_card,
)
from depthcli.training.settings import resolve_config

ALL = replace(SUPERVISED, data=replace(SUPERVISED.data, holdout_every=0))
SIX = tuple(f"{i:04d}" for i in range(6))
YARD = "own pairs (yard)"
SAVED = DataProvenance(
    train_ids=("a", "b"),
    fingerprint="1",
    pseudo_label_fingerprint="2",
    init_weights="default 1.1.0",
)


def _seen(path: Path) -> PairIds:
    if path.suffix == ".onnx":
        return ids_of_card(find_model(path).card)
    return Checkpoint.load(path).provenance.seen_ids


def test_each_differing_setting_is_named_with_both_values() -> None:
    config = TrainConfig()
    given = replace(config, seed=7, optim=replace(config.optim, batch_size=4))
    assert config_differences(config, config) == ()
    assert config_differences(config, given) == (
        "seed is 0 there, 7 here",
        "optim.batch_size is 1 there, 4 here",
    )


@pytest.mark.parametrize(
    ("changes", "count"),
    [
        ({}, 0),
        ({"data": "own pairs (moved)"}, 0),
        ({"init_weights": ""}, 0),  # they need not be given again
        ({"init_weights": "fast 1.1.0"}, 1),
        ({"train_ids": ("a",), "held_out_ids": ("b",), "aspect": 2.0}, 2),
        ({"fingerprint": "3"}, 1),
        ({"pseudo_label_fingerprint": "3"}, 1),
        ({"pseudo_label_fingerprint": ""}, 1),
    ],
)
def test_runs_are_compared_by_content_of_their_data(changes: dict[str, str], count: int) -> None:
    assert len(data_differences(SAVED, replace(SAVED, **changes))) == count


def test_folder_keeps_the_configuration_of_its_run(tmp_path: Path) -> None:
    train_two_steps(SUPERVISED, tmp_path)
    saved = saved_checkpoint(tmp_path)
    assert saved is not None
    assert saved.config == SUPERVISED
    for settings in ((), ("seed=3", "optim.ema=0.9")):
        assert resolve_config("proposed", None, (), settings, tmp_path) == SUPERVISED
    for method, settings in (("proposed", ["seed=9"]), ("cut", [])):
        with pytest.raises(CheckpointError):
            resolve_config(method, None, (), settings, tmp_path)


def test_method_preset_files_and_settings_count_in_this_order(tmp_path: Path) -> None:
    file, other = tmp_path / "a.toml", tmp_path / "b.toml"
    file.write_text("seed = 1\nsave_every = 2\nvalidate_every = 3\n")
    other.write_text("seed = 2\nsave_every = 4\n")
    config = resolve_config("proposed", "default", [file, other], ["seed=3"], tmp_path / "new")
    assert (config.seed, config.save_every, config.validate_every) == (3, 4, 3)
    assert (config.method, config.generator.name) == ("proposed", "efficient")
    assert resolve_config("cut") == default_config("cut")
    assert saved_checkpoint(tmp_path) is None
    with pytest.raises(UsageError):
        resolve_config("proposed", settings=["method=cut"])
    with pytest.raises(UsageError):
        resolve_config("cut", settings=["loss.l1=1", "data.paired=true"])


@pytest.fixture
def first(tmp_path: Path) -> Path:
    """A checkpoint of a network that was trained on six pairs of NYU."""
    train_two_steps(ALL, tmp_path / "first", title=NYU_PAPER)
    return tmp_path / "first" / CHECKPOINT


@pytest.mark.parametrize("title", [NYU_PAPER, YARD])
def test_pairs_of_init_weights_are_recorded(tmp_path: Path, first: Path, title: str) -> None:
    later = tmp_path / "later" / CHECKPOINT
    train_two_steps(SUPERVISED, later.parent, first, title=title)
    provenance = Checkpoint.load(later).provenance
    assert provenance.init_ids == {NYU: SIX}
    assert "0002" in provenance.held_out_ids
    model = later.with_name("model.onnx")
    card = export_checkpoint(later, model, ExportOptions("later")).card
    assert card.training["nyu_train_ids"] == "0000-0005"
    assert open_run(later.parent).nyu_ids == SIX
    for source in (later, model):
        assert _seen(source)[NYU] == SIX


def test_chain_of_runs_forgets_no_pair(tmp_path: Path, first: Path) -> None:
    for title in (YARD, NYU_OFFICIAL):
        folder = tmp_path / title
        train_two_steps(SUPERVISED, folder, first, title=title)
        first = folder / CHECKPOINT
    five = tuple(i for i in SIX if i != "0002")
    assert _seen(first) == {NYU: SIX, YARD: five}


@pytest.mark.parametrize(
    ("prefix", "nyu"), [("", SIX), ("photo-", tuple(i for i in SIX if i != "0002"))]
)
def test_pseudo_labels_are_recorded(tmp_path: Path, prefix: str, nyu: tuple[str, ...]) -> None:
    """Those with numbers of NYU, as the rooms have, as its pairs."""
    labels = write_pseudo_labels(tmp_path / "more", prefix)
    train_two_steps(SUPERVISED, tmp_path / "run", None, labels, title=YARD)
    seen = _seen(tmp_path / "run" / CHECKPOINT)
    assert seen.pop(NYU, ()) == nyu
    assert seen["own pairs (more)"] == tuple(prefix + name for name in SIX)
    assert seen.keys() == {"own pairs (more)", YARD}


@pytest.mark.parametrize("title", [NYU_PAPER, YARD])
def test_pseudo_labels_of_held_out_pairs_are_refused(tmp_path: Path, title: str) -> None:
    labels, run = write_pseudo_labels(tmp_path / "yard", prefix=""), tmp_path / "run"
    with pytest.raises(DatasetError):
        train_two_steps(SUPERVISED, run, None, labels, title=title)
    assert not run.exists()
    train_two_steps(ALL, run, None, labels, title=title)


def test_numbers_of_nyu_need_no_leading_zeros(tmp_path: Path) -> None:
    labels = write_pseudo_labels(tmp_path / "more", prefix="")
    for file in [*labels.glob("*/*.png")]:
        file.rename(file.with_name(f"{int(file.stem)}.png"))
    with pytest.raises(DatasetError):
        train_two_steps(SUPERVISED, tmp_path / "run", None, labels, title=NYU_PAPER)
    train_two_steps(ALL, tmp_path / "run", None, labels, title=YARD)
    assert _seen(tmp_path / "run" / CHECKPOINT)[NYU] == SIX


def test_card_without_ids_is_no_error(first: Path) -> None:
    model = first.with_name("model.onnx")
    export_checkpoint(first, model, ExportOptions("first"))
    free = onnx.load(model)
    for entry in free.metadata_props:
        entry.value = entry.value.replace('"0000-0005"', '"all of them"')
    onnx.save(free, first.with_name("free.onnx"))
    assert _seen(first.with_name("free.onnx")) == {}


def test_folder_counts_as_nyu_if_all_its_names_are_numbers_of_nyu() -> None:
    def seen(*ids: str) -> set[str]:
        return set(DataProvenance(train_ids=ids, data=YARD).seen_ids)

    assert seen("0001", "1448") == {YARD, NYU}
    assert seen("0001", "1449") == seen("0001", "hall") == {YARD}
