"""Configurations: defaults, files of differences, settings, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from depthcli.core.codec import DepthCodec
from depthcli.core.validation import FieldError, validated
from depthcli.errors import UsageError
from depthcli.training import config as rules
from depthcli.training.config import LossConfig, OutputConfig, TrainConfig
from depthcli.training.methods.registry import DEFAULTS, default_config
from depthcli.training.methods.table import METHODS
from depthcli.training.networks.build import build_generator
from depthcli.training.settings import FOLDER, apply_overrides, preset_file, updated

REFERENCE = Path(__file__).parents[1] / "reference"


def test_defaults_are_the_papers() -> None:
    config = TrainConfig()
    assert config.loss == LossConfig(1, 0.5, 0.5, 5, 10, 10, 1e-6, gan="lsgan", contrast="cut")
    generator, optim, data = config.generator, config.optim, config.data
    assert (generator.name, generator.width, generator.blocks) == ("resnet", 64, 9)
    assert generator.residual == "stem"
    assert (optim.learning_rate, optim.beta1, optim.beta2) == (2e-4, 0.5, 0.999)
    assert (optim.batch_size, optim.pool_size, optim.epochs) == (1, 50, 200)
    assert (data.width, data.height, data.colour, data.paired) == (256, 256, "value", True)
    assert not data.crop_286
    extras = ("turn", "rotate_deg", "colour_jitter", "gamma", "brightness", "blur", "border")
    assert not any(getattr(data, name) for name in (*extras, "noise", "cutmix"))
    added = ("similarity", "relation", "gradient", "pseudo_label_scale", "l1_backward")
    assert not any(getattr(config.loss, name) for name in added)


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
    ("rule", "least", "most"),
    [
        (rules.Count, 0, None),
        (rules.Positive, 1, None),
        (rules.Amount, 0.0, None),
        (rules.Share, 0.0, math.nextafter(1, 0)),
        (rules.UnitInterval, 0.0, 1.0),
        (rules.PositiveFloat, 0.001, None),
        (rules.Zoom, 1.0, None),
        (rules.Aspect, 0.25, 4.0),
        (rules.Side, 32, None),
        (rules.Width, 1, 1024),
        (rules.Blocks, 1, 128),
    ],
)
def test_ranges_hold_their_ends(rule: Any, least: float, most: float | None) -> None:
    for end, beyond in ((least, -math.inf), (most, math.inf)):
        if end is None:
            continue
        assert validated(rule, end) == end
        step = math.copysign(1, beyond)
        with pytest.raises(FieldError):
            validated(rule, end + step if type(end) is int else math.nextafter(end, beyond))


def test_later_changes_win(tmp_path: Path) -> None:
    first, second = tmp_path / "a.toml", tmp_path / "b.toml"
    first.write_text("seed = 1\n[optim]\nbatch_size = 4\nepochs_decay = 7\n")
    second.write_text("[optim]\nbatch_size = 8\n")
    config = apply_overrides(TrainConfig(), [first, second], ["seed=2", "data.zoom=2"])
    assert (config.seed, config.data.zoom) == (2, 2.0)
    assert (config.optim.batch_size, config.optim.epochs_decay) == (8, 7)
    assert config.generator == TrainConfig().generator


@pytest.mark.parametrize(
    ("setting", "group", "name", "wanted"),
    [
        ("data.paired=false", "data", "paired", False),
        ("data.paired=True", "data", "paired", True),
        ("optim.learning_rate=1e-3", "optim", "learning_rate", 1e-3),
        ("loss.cycle=0", "loss", "cycle", 0.0),
        ("loss.gan=ralsgan", "loss", "gan", "ralsgan"),
        ("generator.encoder=[1,2,3,4,5]", "generator", "encoder", (1, 2, 3, 4, 5)),
    ],
)
def test_settings_are_read_by_type(setting: str, group: str, name: str, wanted: object) -> None:
    found = getattr(
        getattr(apply_overrides(TrainConfig(), [], ["loss.l1=0", setting]), group), name
    )
    assert found == wanted
    assert type(found) is type(wanted)


def test_precision_is_text_though_it_begins_with_a_number() -> None:
    assert apply_overrides(TrainConfig(), [], ["precision=16-mixed"]).precision == "16-mixed"


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("seed", "not of the form"),
        ("speed=1", "speed is unknown; choose from "),
        ("loss.cycles=1", "loss.cycles is unknown; choose from adversarial, "),
        ("loss=1", "loss has to be a group of adversarial, "),
        ("seed.x=1", "seed has to be a whole number from 0 to 4294967295, not "),
        ("seed=1.5", "seed has to be a whole number from 0 to 4294967295, not "),
        ("seed=true", "seed has to be a whole number from 0 to 4294967295, not "),
        ("data.paired=1", "data.paired has to be true or false, not 1"),
        ("loss.cycle=strong", "loss.cycle has to be a number from 0 to 1e30, not 'strong'"),
        ("loss.gan=wgan", "one of lsgan, hinge, ralsgan, not 'wgan'"),
        ("generator.depths=[1,2.5]", "generator.depths.1 has to be a whole number, not 2.5"),
        ("seed={[]: 1}", "seed has to be a whole number from 0 to 4294967295, not "),
        ("=1", "'' is unknown"),
        ("seed=4294967296", "seed has to be a whole number from 0 to 4294967295, not 4294967296"),
        ("optim.learning_rate=1e308", "optim.learning_rate has to be a number from 0 to 1e30"),
        ("data.width=100000", "data.width has to be a whole number from 32 to 4096, not 100000"),
        ("data.units_per_metre=1e30", "data.units_per_metre has to be a number from 0.001 to 1e9"),
    ],
)
def test_nonsense_is_refused_in_one_line(setting: str, reason: str) -> None:
    with pytest.raises(UsageError) as caught:
        apply_overrides(TrainConfig(), [], [setting])
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "setting",
    [
        "optim.batch_size=0",
        "optim.learning_rate=-1",
        "optim.learning_rate=1e999",
        "optim.epochs_decay=-1",
        "optim.pool_size=-1",
        "optim.ema=1",
        "optim.beta2=1.0",
        "data.width=8",
        "data.height=0",
        "data.zoom=0.5",
        "data.holdout_every=-1",
        "data.noise=-0.1",
        "data.turn=-0.1",
        "data.turn=1.1",
        "data.border=1.1",
        "loss.pseudo_label_scale=1.1",
        "generator.width=1025",
        "validate_every=0",
        "save_every=0",
        "output.min_m=0",
        "output.max_m=1e300",
        "output.max_m=0.3",
        "generator.width=0",
        "generator.dropout=1",
        "loss.cycle=-1",
        "seed=-1",
    ],
)
def test_values_out_of_range_are_refused(setting: str) -> None:
    with pytest.raises(UsageError, match=setting.partition("=")[0].rpartition(".")[2]):
        apply_overrides(TrainConfig(), [], [setting])


@pytest.mark.parametrize(
    "setting",
    [
        *("encoder=[4,4]", "decoder=[4,4,4,0]", "depths=[]"),
        *("encoder=[4,4,4,4,4097]", "decoder=[4,4,4,4097]", "depths=[1,1,1,65]"),
    ],
)
def test_efficient_needs_every_level(setting: str) -> None:
    with pytest.raises(UsageError, match=setting.partition("=")[0]):
        apply_overrides(TrainConfig(), [], ["generator.name=efficient", f"generator.{setting}"])


@pytest.mark.parametrize("name", ["resnet", "efficient"])
@pytest.mark.parametrize("side", ["width", "height"])
def test_sizes_are_those_that_an_exported_model_takes(name: str, side: str) -> None:
    settings = [f"generator.name={name}", "optim.batch_size=2"]
    with pytest.raises(UsageError, match=rf"data\.{side} must be a multiple of 4, not 66"):
        apply_overrides(TrainConfig(), [], [*settings, f"data.{side}=66"])
    apply_overrides(TrainConfig(), [], [*settings, f"data.{side}=68"])


@pytest.mark.parametrize("size", [(32, 32, 1), (36, 32, 1), (32, 36, 1), (32, 32, 2)])
def test_efficient_needs_two_values_to_normalise(size: tuple[int, int, int]) -> None:
    width, height, batch_size = size
    settings = [f"data.width={width}", f"data.height={height}", f"optim.batch_size={batch_size}"]
    settings += ["generator.name=efficient", "generator.encoder=[4,4,4,4,4]"]
    settings += ["generator.decoder=[4,4,4,4]"]
    pictures = torch.rand(batch_size, 1, height, width)
    if size != (32, 32, 1):
        generator = build_generator(apply_overrides(TrainConfig(), [], settings).generator)
        assert generator.train()(pictures).isfinite().all()
        return
    with pytest.raises(UsageError, match=r"raise data\.width, data\.height or optim\.batch_size"):
        apply_overrides(TrainConfig(), [], settings)
    apply_overrides(TrainConfig(), [], [*settings, "generator.name=resnet"])


UNPAIRED = ("data.paired=false", "loss.l1=0")


@pytest.mark.parametrize(
    "setting", ["l1=1", "gradient=0.5", "l1_backward=true", "contrast=cfl", "contrast=cut"]
)
def test_losses_against_the_truth_need_pairs(setting: str) -> None:
    loss = f"loss.{setting}"
    apply_overrides(TrainConfig(), [], [loss])
    if setting == "contrast=cut":
        assert not apply_overrides(TrainConfig(), [], [*UNPAIRED, loss]).data.paired
        return
    with pytest.raises(UsageError, match=rf"^loss\.{setting.partition('=')[0]}.*data\.paired=true"):
        apply_overrides(TrainConfig(), [], [*UNPAIRED, loss])


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (["data.rotate_deg=20"], "data.zoom"),
        (["data.turn=0.5"], "data.turn needs room"),
        (["data.crop_286=true", "data.zoom=1.5"], "data.crop_286 and data.zoom"),
        (["data.crop_286=true", "data.aspects=[2]"], "data.crop_286 and data.aspects"),
        (["data.zoom=2", "data.rotate_deg=11.5"], "data.rotate_deg is at most 11.4"),
        (["output.min_m=10"], "output.min_m"),
        (["data.width=40", "data.height=40", "data.aspects=[4]"], "views of 80×16 pixels"),
        (["data.cutmix=0.5"], "optim.batch_size"),
        (["optim.epochs_constant=0", "optim.epochs_decay=0"], "optim.epochs_decay"),
    ],
)
def test_what_would_do_nothing_is_refused(settings: list[str], reason: str) -> None:
    with pytest.raises(UsageError, match=re.escape(reason)):
        apply_overrides(TrainConfig(), [], settings)


@pytest.mark.parametrize(
    "settings",
    [
        ["data.zoom=2", "data.rotate_deg=11.4"],
        ["data.zoom=1.5", "data.turn=0.5", "data.aspects=[2]"],
        ["data.crop_286=true"],
        ["data.cutmix=0.5", "optim.batch_size=2"],
        ["optim.epochs_constant=0", "optim.epochs_decay=1"],
        ["generator.name=efficient", "generator.encoder=[1,1,1,1,4096]"],
        ["generator.name=efficient", "generator.decoder=[1,1,1,4096]"],
        ["generator.name=efficient", "generator.depths=[1,1,1,64]"],
    ],
)
def test_what_is_just_possible_is_taken(settings: list[str]) -> None:
    apply_overrides(TrainConfig(), [], settings)


@pytest.mark.parametrize("content", [b"seed = ", b"\xff\xfe", None])
def test_bad_files_are_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "run.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UsageError, match=r"run\.toml"):
        apply_overrides(TrainConfig(), [path], [])


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("a = " + "[" * 100_000, "is not TOML"),
        ("seed = " + "9" * 5000, "is not TOML"),
        (
            f"seed = {10**40}",
            "seed has to be a whole number from 0 to 4294967295, not a number of more than 64 bits",
        ),
        (
            f"loss.cycle = {10**400}",
            "loss.cycle has to be a number from 0 to 1e30, not a number of more than 64 bits",
        ),
        (
            f"data.aspects = [{10**400}]",
            "data.aspects.0 has to be a number from 1/4 to 4, not a number of more than 64 bits",
        ),
        (f"{'x' * 5000} = 1", "xxxxxx is unknown"),
        ("loss = 3", "loss has to be a group of "),
        (
            "seed = 1979-05-27",
            "seed has to be a whole number from 0 to 4294967295, not datetime.date",
        ),
    ],
)
def test_a_bad_value_names_its_file(tmp_path: Path, content: str, reason: str) -> None:
    file = tmp_path / "a.toml"
    file.write_text(content)
    with pytest.raises(UsageError, match=r"a\.toml.*") as caught:
        apply_overrides(TrainConfig(), [file], [])
    assert reason in str(caught.value)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 1000


def test_a_file_is_read_up_to_a_mebibyte(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_bytes(b"seed = 4\n#".ljust(2**20, b"x"))
    assert apply_overrides(TrainConfig(), [file], []).seed == 4
    file.write_bytes(b"seed = 4\n#".ljust(2**20 + 1, b"x"))
    with pytest.raises(UsageError, match=r"a\.toml"):
        apply_overrides(TrainConfig(), [file], [])


def test_a_pipe_is_no_configuration(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.toml")
    with pytest.raises(UsageError, match=r"a\.toml: it is a pipe"):
        apply_overrides(TrainConfig(), [tmp_path / "a.toml"], [])


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.toml")), ids=lambda p: p.stem)
def test_presets_resolve(file: Path) -> None:
    config = apply_overrides(TrainConfig(), [preset_file(file.stem)], [])
    wanted = tomllib.loads(file.read_text())
    assert updated(config, wanted) == config
    assert config != TrainConfig()


def _leaves(values: dict[str, Any], path: str = "") -> dict[str, Any]:
    leaves: dict[str, Any] = {}
    for name, value in values.items():
        inner = (
            _leaves(value, f"{path}{name}.") if isinstance(value, dict) else {path + name: value}
        )
        leaves |= inner
    return leaves


@pytest.mark.parametrize("name", METHODS)
def test_a_methods_file_holds_only_differences(name: str) -> None:
    written = _leaves(tomllib.loads((DEFAULTS / f"{name}.toml").read_text()))
    usual = _leaves(dataclasses.asdict(TrainConfig()))
    assert not [path for path, value in written.items() if usual[path] == value]


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.toml")), ids=lambda p: p.stem)
def test_a_preset_holds_only_differences(file: Path) -> None:
    usual = [_leaves(dataclasses.asdict(default_config(name))) for name in METHODS]
    for path, value in _leaves(tomllib.loads(file.read_text())).items():
        assert any(config[path] != value for config in usual), path


def test_unknown_preset_names_the_known() -> None:
    with pytest.raises(UsageError, match=r"no preset 'huge'; choose from .*default"):
        preset_file("huge")


def test_a_checkpoints_dictionary_gives_the_configuration_back() -> None:
    config = apply_overrides(
        TrainConfig(), [preset_file("default")], ["generator.depths=[1,1,1,2]"]
    )
    assert updated(TrainConfig(), dataclasses.asdict(config)) == config


def test_codecs_span_the_range_between_minus_one_and_one() -> None:
    ends = np.float32([-1, 1])
    np.testing.assert_allclose(OutputConfig().codec.decode(ends), [0, 10], atol=1e-6)
    log = OutputConfig("log", min_m=0.5, max_m=8).codec
    np.testing.assert_allclose(log.decode(ends), [0.5, 8], rtol=1e-6)
