"""Checkpoints: whole or refused, never executed, never half written."""

from __future__ import annotations

import os
import pickle
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers.rooms import EFFICIENT, PAPER

from depthcli.core.options import Weights
from depthcli.errors import CheckpointError
from depthcli.training.checkpoint import Checkpoint, TrainState, load_generator
from depthcli.training.networks.build import build_generator


def _checkpoint(config: Any = EFFICIENT, *, average: bool = False) -> Checkpoint:
    torch.manual_seed(4)
    weights = build_generator(config.generator).state_dict()
    named = {f"generator.{name}": value for name, value in weights.items()}
    smooth = {name: value * 0 + 7 for name, value in weights.items()}
    return Checkpoint(
        config=config,
        progress=TrainState(3, 1, 2.5, {"abs_rel": 0.5}, ("a", "b"), ("c",)),
        method=named,
        average=smooth if average else None,
        optimizers={},
        extra={"pool": [torch.ones(1, 2, 2)]},
        rng=torch.get_rng_state(),
    )


def _saved(folder: Path) -> Path:
    _checkpoint().save(folder / "a.ckpt")
    return folder / "a.ckpt"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What is in the file of a checkpoint with an average."""
    path = tmp_path_factory.mktemp("whole") / "a.ckpt"
    _checkpoint(average=True).save(path)
    content: dict[str, Any] = torch.load(path, weights_only=True)
    return content


def _written(folder: Path, content: dict[str, Any]) -> Path:
    """A file of entries, without those that are None."""
    path = folder / "a.ckpt"
    torch.save({name: value for name, value in content.items() if value is not None}, path)
    return path


def test_comes_back_whole(tmp_path: Path) -> None:
    saved, loaded = _checkpoint(), Checkpoint.load(_saved(tmp_path))
    assert loaded.config == saved.config
    assert loaded.state == saved.state
    assert torch.equal(loaded.rng, saved.rng)
    assert torch.equal(loaded.extra["pool"][0], saved.extra["pool"][0])
    assert all(torch.equal(loaded.method[name], saved.method[name]) for name in saved.method)


def test_others_may_read_it_if_they_may_read_other_files(tmp_path: Path) -> None:
    (tmp_path / "other").touch()
    assert _saved(tmp_path).stat().st_mode == (tmp_path / "other").stat().st_mode


def test_what_a_checkpoint_of_before_does_not_say_is_what_it_was_then(
    tmp_path: Path, whole: dict[str, Any]
) -> None:
    later = dict.fromkeys(("device_rng", "precision", "others"))
    loaded = Checkpoint.load(_written(tmp_path, whole | {"progress": {}} | later))
    assert (loaded.device_rng, loaded.precision, loaded.others) == (None, {}, [])
    assert asdict(loaded.state) == {
        "step": 0,
        "epoch": 0,
        "seconds": 0.0,
        "scores": {},
        "train_ids": (),
        "held_out_ids": (),
        "data": "NYU Depth v2, labelled pairs 1-1000",
        "hfov_deg": 63.3,
        "extra": "",
        "pseudo_label_ids": {},
        "start": "",
        "start_pairs": {},
        "start_ids": (),
        "aspect": 4 / 3,
        "fingerprints": (),
        "threads": 0,
    }


def test_former_names_of_discriminators_are_read(tmp_path: Path, whole: dict[str, Any]) -> None:
    weight = torch.arange(3.0)
    former = {f"{name}.w": weight for name in ("judge", "judge_depth", "judge_gray", "generator")}
    path = _written(tmp_path, whole | {"method": former, "average": {}})
    named = Checkpoint.load(path).method
    current = ["discriminator.w", "depth_discriminator.w", "gray_discriminator.w", "generator.w"]
    assert list(named) == current
    assert all(torch.equal(one, weight) for one in named.values())


def test_generator_is_the_average_where_there_is_one(tmp_path: Path) -> None:
    for average in (False, True):
        _checkpoint(average=average).save(tmp_path / "a.ckpt")
        generator, loaded = load_generator(tmp_path / "a.ckpt")
        assert not generator.training
        assert loaded.config == EFFICIENT
        assert bool((generator.state_dict()["stem.0.weight"] == 7).all()) is average
        raw, _ = load_generator(tmp_path / "a.ckpt", Weights.RAW)
        own = _checkpoint().method
        assert all(torch.equal(own[f"generator.{n}"], w) for n, w in raw.state_dict().items())


@pytest.mark.parametrize("share", [0, 0.01, 0.5, 0.999])
def test_truncated_is_refused(tmp_path: Path, share: float) -> None:
    path = _saved(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(CheckpointError, match="not a complete checkpoint"):
        Checkpoint.load(path)


@pytest.mark.parametrize("content", [b"hello, world\n" * 50, b"\x89PNG\r\n\x1a\n" + b"\0" * 200])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.ckpt"
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="not a complete checkpoint"):
        Checkpoint.load(path)


def test_missing_and_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no checkpoint at"):
        Checkpoint.load(tmp_path / "a.ckpt")
    with pytest.raises(CheckpointError, match="not a complete checkpoint"):
        Checkpoint.load(tmp_path)


@pytest.mark.parametrize("content", [{"state_dict": {}}, torch.zeros(3), [1, 2]])
def test_foreign_checkpoints_are_refused(tmp_path: Path, content: object) -> None:
    torch.save(content, tmp_path / "a.ckpt")
    with pytest.raises(CheckpointError, match="not made by `depthcli train`"):
        Checkpoint.load(tmp_path / "a.ckpt")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"version": 99}, "another version"),
        ({"version": None}, "another version"),
        ({"config": {"no_such": 1}}, "another version: no_such is unknown; choose from"),
        ({"config": None}, "another version: has to be a group of .*, not None"),
        ({"config": 3}, "another version: has to be a group of .*, not 3"),
        ({"progress": None}, "lacks parts"),
        ({"average": None}, "lacks parts"),
        ({"method": None}, "lacks parts"),
        ({"more": 1}, "lacks parts"),
    ],
)
def test_other_versions_are_refused(
    tmp_path: Path, whole: dict[str, Any], changes: dict[str, object], reason: str
) -> None:
    with pytest.raises(CheckpointError, match=reason) as caught:
        Checkpoint.load(_written(tmp_path, whole | changes))
    assert "\n" not in str(caught.value)


def _nested(depth: int) -> list[Any]:
    nested: list[Any] = []
    for _ in range(depth):
        nested = [nested]
    return nested


_VAST = torch.ones(1).expand(1, 10**5, 10**5)  # 40 GB, of a file of some bytes
_DEEP = {"name": "efficient", "depths": (10**9, 1, 1, 1)}


@pytest.mark.parametrize(
    ("part", "changes", "reason"),
    [
        ("method", {"generator.stem.0.weight": torch.tensor([torch.nan])}, "stem.*not finite"),
        ("method", {"generator.stem.0.weight": _VAST[0]}, "stem.* larger than what the file holds"),
        ("extra", {"pool": [_VAST]}, "pool is larger than what the file holds"),
        ("optimizers", {"generator": {"state": {0: _VAST}}}, "larger than what the file holds"),
        ("method", {"generator.stem.0.weight": 3}, "has to be tensors by name"),
        ("method", {4: torch.ones(1)}, "has to be tensors by name"),
        ("average", {"stem.0.weight": torch.tensor([torch.inf])}, "the average: stem.*not finite"),
        ("progress", {"hfov_deg": -63.3}, "hfov_deg has to be an angle from 0.1 to 179.9"),
        ("progress", {"hfov_deg": torch.nan}, "hfov_deg has to be an angle from 0.1 to 179.9"),
        ("progress", {"hfov_deg": "wide"}, "hfov_deg has to be .*, not 'wide'"),
        ("progress", {"hfov_deg": 10**40}, "hfov_deg has to be .*more than 64 bits"),
        ("progress", {"aspect": 0.0}, "aspect has to be a number above 0"),
        ("progress", {"step": -1}, "step has to be a whole number from 0 up, not -1"),
        ("progress", {"step": 1.5}, "step has to be a whole number"),
        ("progress", {"seconds": None}, "seconds has to be a number"),
        ("progress", {"scores": [1]}, "scores has to be an object, not "),
        ("progress", {"train_ids": [1, 2]}, "train_ids.0 has to be text, not 1"),
        ("progress", {"data": _nested(50)}, r"data has to be text, not \[\[.*\.\.\."),
        ("config", {"output": {"min_m": -2.0, "max_m": -1.0}}, "output.min_m is above 0"),
        ("config", {"output": {"max_m": torch.nan}}, "output.max_m has to be a number, not nan"),
        (
            "config",
            {"generator": {"name": "resnet", "blocks": 10**9}},
            "blocks has to be .* to 128",
        ),
        ("config", {"generator": _DEEP}, "depths is at most 64"),
        ("config", {"generator": {"width": 10**9}}, "width has to be .* to 1024"),
        (
            "config",
            {"optim": {"learning_rate": 10**400}},
            "learning_rate has to be a number from 0 to 1e30, not",
        ),
        ("optimizers", {"generator": {"state": {0: torch.tensor(torch.nan)}}}, "not finite"),
        (
            "optimizers",
            {"generator": {"param_groups": [{"lr": torch.inf}]}},
            "optimizers holds numbers that are not finite",
        ),
        ("optimizers", {"generator": _nested(16)}, "nested too deeply"),
        ("precision", {"scale": torch.inf}, "the loss scaler holds numbers that are not finite"),
        ("extra", {"pool": torch.ones(1, 2, 2)}, "pool has to be a list of pictures"),
        ("extra", {"pool": [torch.ones(2, 2)]}, "pool has to be a list of pictures"),
        ("extra", {"pool": [torch.full((1, 2, 2), torch.nan)]}, "pool holds numbers that are not"),
    ],
)
def test_values_that_no_run_writes_are_refused(
    tmp_path: Path, whole: dict[str, Any], part: str, changes: dict[Any, object], reason: str
) -> None:
    path = _written(tmp_path, whole | {part: whole[part] | changes})
    with pytest.raises(CheckpointError, match=reason) as caught:
        Checkpoint.load(path)
    assert "\n" not in str(caught.value)


def test_what_is_just_possible_is_read(tmp_path: Path) -> None:
    """Groups in groups, plain values of every kind, no picture in a pool, a score without value."""
    plain = {"betas": (0.5, 0.9), "fused": None, "amsgrad": False, "name": "Adam", "n": 3}
    kept = replace(
        _checkpoint(),
        optimizers={"generator": plain | {"deep": _nested(14)}},
        extra={"pool": []},
        progress=TrainState(scores={"rmse": float("nan")}),
    )
    kept.save(tmp_path / "a.ckpt")
    loaded = Checkpoint.load(tmp_path / "a.ckpt")
    assert loaded.optimizers == kept.optimizers
    assert (loaded.average, loaded.extra) == (None, {"pool": []})
    assert list(loaded.state.scores) == ["rmse"]


@pytest.mark.parametrize("rng", [3, torch.ones(4), torch.ones(2, 2, dtype=torch.uint8), [1]])
def test_what_is_no_state_of_a_generator_is_refused(
    tmp_path: Path, whole: dict[str, Any], rng: object
) -> None:
    for name in ("rng", "device_rng"):
        path = _written(tmp_path, whole | {name: rng})
        with pytest.raises(CheckpointError, match=f"{name} has to be the state of a generator"):
            Checkpoint.load(path)


@pytest.mark.parametrize("others", [[3], [{}], [{"rng": 1, "device_rng": None, "extra": {}}], 3])
def test_what_other_processes_cannot_have_left_is_refused(
    tmp_path: Path, whole: dict[str, Any], others: object
) -> None:
    path = _written(tmp_path, whole | {"others": others})
    with pytest.raises(CheckpointError, match=r"lacks parts|rng has to be"):
        Checkpoint.load(path)


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    _checkpoint().save(tmp_path / "a.ckpt")
    wrong = replace(_checkpoint(), config=PAPER)
    wrong.save(tmp_path / "a.ckpt")
    with pytest.raises(CheckpointError, match="does not fit its own configuration"):
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
    content = {"format": "depthcli-checkpoint", "version": 1, "config": _Harmful(target)}
    if as_torch:
        torch.save(content, path)
    else:
        path.write_bytes(pickle.dumps(content, protocol=2))
    with pytest.raises(CheckpointError):
        Checkpoint.load(path)
    assert not target.exists()
    torch.load(path, weights_only=False) if as_torch else pickle.loads(path.read_bytes())  # noqa: S301 - its own
    assert target.exists()  # it would have been


def test_failed_write_keeps_the_one_before(tmp_path: Path) -> None:
    path = _saved(tmp_path)
    before = path.read_bytes()
    broken = replace(_checkpoint(), extra={"pool": [_Unwritable()]})
    with pytest.raises(CheckpointError, match=r"cannot write .*older checkpoints are kept"):
        broken.save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.ckpt"]


class _Unwritable:
    def __reduce__(self) -> tuple[Any, ...]:
        raise OSError(28, "No space left on device")


def test_interrupted_write_keeps_the_one_before(tmp_path: Path) -> None:
    path = _saved(tmp_path)
    before = path.read_bytes()
    with pytest.raises(KeyboardInterrupt):
        replace(_checkpoint(), extra={"pool": [_Interrupting()]}).save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.ckpt"]


class _Interrupting:
    def __reduce__(self) -> tuple[Any, ...]:
        raise KeyboardInterrupt


def test_it_is_on_the_disk_before_the_one_that_it_replaces_is_gone(
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


def test_write_into_no_folder_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="cannot write"):
        _checkpoint().save(tmp_path / "gone" / "a.ckpt")


def test_every_field_is_in_the_file(tmp_path: Path) -> None:
    content = torch.load(_saved(tmp_path), weights_only=True)
    assert set(content) == {f.name for f in fields(Checkpoint)} | {"format", "version"}
