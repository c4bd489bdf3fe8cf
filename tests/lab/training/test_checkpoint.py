"""Checkpoints and the provenance of their data."""

import gzip
import os
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import onnx
import pytest
import torch
from helpers.rooms import EFFICIENT, PAPER
from helpers.supervised_runs import SUPERVISED, train_steps, write_pseudo_labels
from lightning_fabric import Fabric

from depthcli.errors import CheckpointError, DatasetError, UsageError
from depthcli.lab.datasets.base import NYU
from depthcli.lab.datasets.training_data import NYU_OFFICIAL, NYU_PAPER
from depthcli.lab.export.onnx import ExportOptions, export_checkpoint, open_run
from depthcli.lab.training.checkpoint import (
    CHECKPOINT,
    Checkpoint,
    TrainState,
    load_generator,
    saved_checkpoint,
)
from depthcli.lab.training.methods.registry import default_config
from depthcli.lab.training.networks.build import build_generator
from depthcli.lab.training.provenance import DataProvenance, PairIds, data_differences, ids_of_card
from depthcli.lab.training.run import Run
from depthcli.lab.training.settings import resolve_config
from depthcli.models.catalog import find_model

STORED = Path(__file__).with_name("checkpoint-0.24.ckpt.gz")
"""Two steps by depthcli 0.24 with pseudo labels, from the init weights of another run."""
STORED_CONFIG = replace(
    SUPERVISED,
    generator=replace(SUPERVISED.generator, encoder=(8,) * 5, decoder=(8,) * 4),
    optim=replace(SUPERVISED.optim, ema=0.9),
    loss=replace(SUPERVISED.loss, pseudo_label_scale=0.5),
)


def _checkpoint(config: Any = EFFICIENT, *, average: bool = False) -> Checkpoint:
    torch.manual_seed(4)
    weights = build_generator(config.generator).state_dict()
    return Checkpoint(
        config=config,
        state=TrainState(3, 1, 2.5, {"abs_rel": 0.5, "rmse": float("inf")}, 2),
        provenance=DataProvenance(
            train_ids=("a", "b"), held_out_ids=("c",), init_ids={"x": ("y",)}
        ),
        method={f"generator.{name}": value for name, value in weights.items()},
        ema_generator={n: value * 0 + 7 for n, value in weights.items()} if average else None,
        optimizers={},
        extra={"pool": [torch.ones(1, 2, 2)]},
        rng=torch.get_rng_state(),
    )


def _saved(folder: Path) -> Path:
    _checkpoint().save(folder / "a.ckpt")
    return folder / "a.ckpt"


def test_run_of_0_24_resumes_with_its_numbers(tmp_path: Path) -> None:
    path = tmp_path / "run" / CHECKPOINT
    path.parent.mkdir()
    path.write_bytes(gzip.decompress(STORED.read_bytes()))
    assert Checkpoint.load(path).config == STORED_CONFIG
    state = train_steps(STORED_CONFIG, path.parent, None, write_pseudo_labels(tmp_path / "x"))
    assert (state.step, state.epoch) == (4, 2)
    assert state.scores["abs_rel"] == pytest.approx(0.4193221335098589, rel=1e-4)
    assert Checkpoint.load(path).provenance.init_weights.startswith("last.ckpt ")


def test_weights_to_start_from_that_the_repository_has_are_read() -> None:
    starts = Path(__file__).parents[3] / "models" / "starts" / "lite0.ckpt"  # "others", of 0.17
    saved = load_generator(starts)[1]  # whose weights fit its network
    assert (saved.state.step, len(saved.provenance.train_ids)) == (1193, 866)


def test_other_users_may_read_checkpoints_as_other_files(tmp_path: Path) -> None:
    (tmp_path / "other").touch()
    assert _saved(tmp_path).stat().st_mode == (tmp_path / "other").stat().st_mode


@pytest.mark.parametrize("share", [0, 0.5, 0.999])
def test_truncated_checkpoint_is_refused(tmp_path: Path, share: float) -> None:
    path = _saved(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(CheckpointError):
        Checkpoint.load(path)


@pytest.mark.parametrize("content", [{"state_dict": {}}, torch.zeros(3), [1, 2]])
def test_foreign_files_are_refused(tmp_path: Path, content: object) -> None:
    torch.save(content, tmp_path / "a.ckpt")
    (tmp_path / "b.ckpt").write_bytes(b"hello, world\n" * 50)
    os.mkfifo(tmp_path / "pipe.ckpt")
    for name in ("a.ckpt", "b.ckpt", "none.ckpt", "pipe.ckpt", ""):
        with pytest.raises(CheckpointError):
            Checkpoint.load(tmp_path / name)


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("version", 1),
        ("version", 99),
        ("config", {"no_such": 1}),
        ("config", {"generator": {"blocks": 10_000_000}}),  # all memory would be taken
        ("config", {"output": {"min_m": 9.0, "max_m": 1.0}}),
        ("state", {"step": -1}),
        ("state", {"scores": [1]}),
        ("provenance", {"hfov_deg": -63.3}),
        ("provenance", {"train_ids": [1, 2]}),
        ("state", None),
        ("ema_generator", ...),
        ("more", 1),
    ],
)
def test_contents_that_no_run_writes_are_refused(tmp_path: Path, part: str, value: object) -> None:
    content = torch.load(_saved(tmp_path), weights_only=True) | {part: value}
    torch.save({name: v for name, v in content.items() if v is not ...}, tmp_path / "a.ckpt")
    with pytest.raises(CheckpointError) as caught:
        Checkpoint.load(tmp_path / "a.ckpt")
    assert "\n" not in str(caught.value)


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    replace(_checkpoint(), config=PAPER).save(tmp_path / "a.ckpt")
    with pytest.raises(CheckpointError):
        load_generator(tmp_path / "a.ckpt")


class _Harmful:
    """Unpickled, it would make a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.target,)


@pytest.mark.parametrize("as_torch", [True, False])
def test_nothing_in_a_file_is_executed(tmp_path: Path, as_torch: bool) -> None:
    path, target = tmp_path / "a.ckpt", tmp_path / "executed"
    content = {"format": "depthcli-checkpoint", "version": 2, "config": _Harmful(target)}
    if as_torch:
        torch.save(content, path)
    else:
        path.write_bytes(pickle.dumps(content, protocol=2))
    with pytest.raises(CheckpointError):
        Checkpoint.load(path)
    assert not target.exists()
    torch.load(path, weights_only=False) if as_torch else pickle.loads(path.read_bytes())  # noqa: S301 - its own
    assert target.exists()  # it would have been


def test_checkpoint_reaches_the_disk_before_it_replaces_the_previous_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a power cut, one of the two has to be whole."""
    path = _saved(tmp_path)
    before, reached = path.read_bytes(), []

    def noted(descriptor: int, reach_disk: Any = os.fsync) -> None:
        reach_disk(descriptor)
        reached.append((os.fstat(descriptor).st_ino, path.read_bytes() == before))

    monkeypatch.setattr(os, "fsync", noted)
    replace(_checkpoint(), extra={"pool": [torch.zeros(1, 3, 3)]}).save(path)
    assert reached == [(path.stat().st_ino, True)]
    assert path.read_bytes() != before


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


def test_losses_of_other_packages_are_named_by_the_command_of_a_resumed_run(tmp_path: Path) -> None:
    named = "loss.custom.torch.nn.functional:l1_loss=1"
    custom = {"torch.nn.functional:l1_loss": 1.0}
    config = replace(SUPERVISED, loss=replace(SUPERVISED.loss, custom=custom))
    run = Run(config, Fabric(accelerator="cpu", devices=1), 5)
    run.save(tmp_path / CHECKPOINT)
    assert resolve_config("proposed", settings=[named], folder=tmp_path) == config
    with pytest.raises(CheckpointError):
        resolve_config("proposed", folder=tmp_path)


def test_method_preset_files_and_settings_count_in_this_order(tmp_path: Path) -> None:
    file, other = tmp_path / "a.toml", tmp_path / "b.toml"
    file.write_text("seed = 1\nsave_every = 2\nvalidate_every = 3\n")
    other.write_text("seed = 2\nsave_every = 4\n")
    config = resolve_config("proposed", "bundled", [file, other], ["seed=3"], tmp_path / "new")
    assert (config.seed, config.save_every, config.validate_every) == (3, 4, 3)
    assert (config.method, config.generator.name) == ("proposed", "efficient")
    assert resolve_config("cut") == default_config("cut")
    assert saved_checkpoint(tmp_path) is None
    with pytest.raises(UsageError):
        resolve_config("proposed", settings=["method=cut"])
    with pytest.raises(UsageError):
        resolve_config("cut", settings=["loss.l1=1", "data.paired=true"])


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint of a network that was trained on six pairs of NYU."""
    folder = tmp_path_factory.mktemp("first")
    train_steps(ALL, folder, title=NYU_PAPER)
    return folder / CHECKPOINT


@pytest.mark.parametrize("title", [NYU_PAPER, YARD])
def test_pairs_of_init_weights_are_recorded(tmp_path: Path, first: Path, title: str) -> None:
    later = tmp_path / "later" / CHECKPOINT
    train_steps(SUPERVISED, later.parent, first, title=title)
    provenance = Checkpoint.load(later).provenance
    assert provenance.init_ids == {NYU: SIX}
    assert "0002" in provenance.held_out_ids
    model = later.with_name("model.onnx")
    card = export_checkpoint(later, model, ExportOptions("later")).card
    assert card.training["nyu_train_ids"] == "0000-0005"
    assert open_run(later.parent).provenance.seen_ids[NYU] == SIX
    for source in (later, model):
        assert _seen(source)[NYU] == SIX


def test_chain_of_runs_forgets_no_pair(tmp_path: Path, first: Path) -> None:
    for title in (YARD, NYU_OFFICIAL):
        folder = tmp_path / title
        train_steps(SUPERVISED, folder, first, title=title)
        first = folder / CHECKPOINT
    five = tuple(i for i in SIX if i != "0002")
    assert _seen(first) == {NYU: SIX, YARD: five}


@pytest.mark.parametrize(
    ("prefix", "nyu"), [("", SIX), ("photo-", tuple(i for i in SIX if i != "0002"))]
)
def test_pseudo_labels_are_recorded(tmp_path: Path, prefix: str, nyu: tuple[str, ...]) -> None:
    """Those with numbers of NYU, as the rooms have, as its pairs."""
    labels = write_pseudo_labels(tmp_path / "more", prefix)
    train_steps(SUPERVISED, tmp_path / "run", None, labels, title=YARD)
    ids = _seen(tmp_path / "run" / CHECKPOINT)
    assert ids.pop(NYU, ()) == nyu
    assert ids["own pairs (more)"] == tuple(prefix + name for name in SIX)
    assert ids.keys() == {"own pairs (more)", YARD}


@pytest.mark.parametrize("title", [NYU_PAPER, YARD])
def test_pseudo_labels_of_held_out_pairs_are_refused(tmp_path: Path, title: str) -> None:
    labels, run = write_pseudo_labels(tmp_path / "yard", prefix=""), tmp_path / "run"
    with pytest.raises(DatasetError):
        train_steps(SUPERVISED, run, None, labels, title=title)
    assert not run.exists()
    train_steps(ALL, run, None, labels, title=title)


def test_numbers_of_nyu_need_no_leading_zeros(tmp_path: Path) -> None:
    labels = write_pseudo_labels(tmp_path / "more", prefix="")
    for file in [*labels.glob("*/*.png")]:
        file.rename(file.with_name(f"{int(file.stem)}.png"))
    with pytest.raises(DatasetError):
        train_steps(SUPERVISED, tmp_path / "run", None, labels, title=NYU_PAPER)
    train_steps(ALL, tmp_path / "run", None, labels, title=YARD)
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
