"""Configurations: defaults, files of differences, settings, and what is refused."""

import dataclasses
import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from depthcli.core.types import DepthCodec
from depthcli.errors import UsageError
from depthcli.lab.training.config import TrainConfig, updated
from depthcli.lab.training.methods.table import PAPER_METHODS, PRESETS
from depthcli.lab.training.settings import PRESET_FOLDER, apply_overrides, resolve_config

REFERENCE = Path(__file__).parents[2] / "reference"


def test_defaults_never_change() -> None:
    """What a checkpoint or a file of an earlier version does not say is what it was then."""
    stored = json.loads((REFERENCE / "training-defaults.json").read_text("utf-8"))
    now = _leaves(json.loads(json.dumps(dataclasses.asdict(TrainConfig()))))
    assert {name: now.get(name) for name in _leaves(stored)} == _leaves(stored)
    assert (TrainConfig().output.codec, TrainConfig().optim.epochs) == (
        DepthCodec("linear", 5, 5),
        200,
    )


@pytest.mark.parametrize(
    ("setting", "group", "name", "expected"),
    [
        ("data.paired=false", "data", "paired", False),
        ("optim.learning_rate=1e-3", "optim", "learning_rate", 1e-3),
        ("loss.cycle=0", "loss", "cycle", 0.0),
        ("loss.gan=ralsgan", "loss", "gan", "ralsgan"),
        ("generator.encoder=[1,2,3,4,5]", "generator", "encoder", (1, 2, 3, 4, 5)),
    ],
)
def test_settings_are_read_by_type(setting: str, group: str, name: str, expected: object) -> None:
    value = getattr(
        getattr(apply_overrides(TrainConfig(), [], ["loss.l1=0", setting]), group), name
    )
    assert value == expected
    assert type(value) is type(expected)


@pytest.mark.parametrize(
    "setting",
    [
        *("seed", "speed=1", "loss.cycles=1", "loss=1", "seed.x=1", "seed=1.5", "seed=true"),
        *("data.paired=1", "loss.cycle=strong", "loss.gan=wgan", "generator.depths=[1,2.5]"),
        *("optim.batch_size=0", "optim.learning_rate=-1", "optim.ema=1", "data.width=8"),
        *("data.width=66", "data.zoom=0.5", "data.turn=1.1", "output.min_m=0", "output.min_m=10"),
        *("generator.width=0", "seed=4294967296", "optim.learning_rate=1e999", "validate_every=0"),
    ],
)
def test_settings_out_of_range_are_refused_by_name(setting: str) -> None:
    with pytest.raises(UsageError, match=setting.partition("=")[0].rpartition(".")[2]) as caught:
        apply_overrides(TrainConfig(), [], [setting])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("setting", ["encoder=[4,4]", "decoder=[4,4,4,0]", "depths=[]"])
def test_efficient_network_needs_every_level(setting: str) -> None:
    with pytest.raises(UsageError, match=setting.partition("=")[0]):
        apply_overrides(TrainConfig(), [], ["generator.name=efficient", f"generator.{setting}"])


@pytest.mark.parametrize("content", [b"seed = ", b"\xff\xfe", b"seed = 1.5", b"loss = 3", None])
def test_file_that_cannot_be_used_is_named(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "run.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UsageError):
        apply_overrides(TrainConfig(), [path], [])


def test_losses_of_other_packages_add_up() -> None:
    settings = ["loss.custom.mine:a=1", "loss.custom.my.losses:b=2"]
    custom = apply_overrides(TrainConfig(), [], settings).loss.custom
    assert custom == {"mine:a": 1.0, "my.losses:b": 2.0}


UNPAIRED = ("data.paired=false", "loss.l1=0")


@pytest.mark.parametrize(
    "setting", ["l1=1", "gradient=0.5", "contrast=cfl", "l1_backward=true", "contrast=cut"]
)
def test_losses_against_the_truth_need_pairs(setting: str) -> None:
    loss = f"loss.{setting}"
    apply_overrides(TrainConfig(), [], [loss])
    if setting in {"l1_backward=true", "contrast=cut"}:  # of an L1 without weight, the former
        assert not apply_overrides(TrainConfig(), [], [*UNPAIRED, loss]).data.paired
        return
    with pytest.raises(UsageError):
        apply_overrides(TrainConfig(), [], [*UNPAIRED, loss])


@pytest.mark.parametrize("file", sorted(PRESET_FOLDER.glob("*.toml")), ids=lambda p: p.stem)
def test_presets_resolve(file: Path) -> None:
    config = apply_overrides(TrainConfig(), [file], [])
    settings = tomllib.loads(file.read_text())
    assert updated(config, settings) == config
    assert config != TrainConfig()


def _leaves(values: dict[str, Any], path: str = "") -> dict[str, Any]:
    leaves: dict[str, Any] = {}
    for name, value in values.items():
        inner = (
            _leaves(value, f"{path}{name}.") if isinstance(value, dict) else {path + name: value}
        )
        leaves |= inner
    return leaves


def test_presets_and_files_are_the_same() -> None:
    assert {file.stem for file in PRESET_FOLDER.glob("*.toml")} == set(PRESETS)


@pytest.mark.parametrize("method", PAPER_METHODS)
@pytest.mark.parametrize("preset", PRESETS)
def test_preset_is_refused_for_other_methods_than_its_own(preset: str, method: str) -> None:
    if PRESETS[preset] in ("", method):
        assert resolve_config(method, preset).method == method
    else:
        with pytest.raises(UsageError, match=f"{preset} is for the method {PRESETS[preset]}"):
            resolve_config(method, preset)


@pytest.mark.parametrize("preset", ["paper", "paper-small", "reduced", None])
def test_proposed_has_the_weights_of_the_pilot(preset: str | None) -> None:
    config = resolve_config("proposed", preset)
    assert (config.loss.l1, config.loss.l1_backward, config.generator.name) == (100, True, "resnet")
