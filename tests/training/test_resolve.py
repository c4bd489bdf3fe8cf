"""The configuration of a run: a new one's, and a folder's own."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from helpers.rooms import EFFICIENT
from lightning_fabric import Fabric

from depthcli.errors import CheckpointError, UsageError
from depthcli.training.checkpoint import CHECKPOINT
from depthcli.training.methods.registry import default_config
from depthcli.training.resolve import resolve_config, saved_checkpoint
from depthcli.training.run import Run

if TYPE_CHECKING:
    from pathlib import Path


def test_method_preset_files_and_settings_count_in_this_order(tmp_path: Path) -> None:
    file, other = tmp_path / "a.toml", tmp_path / "b.toml"
    file.write_text("seed = 1\nsave_every = 2\nvalidate_every = 3\n")
    other.write_text("seed = 2\nsave_every = 4\n")
    config = resolve_config("proposed", "default", [file, other], ["seed=3"], tmp_path / "new")
    assert (config.seed, config.save_every, config.validate_every) == (3, 4, 3)
    assert (config.method, config.generator.name) == ("proposed", "efficient")
    assert resolve_config("cut") == default_config("cut")
    assert saved_checkpoint(tmp_path) is None


def test_what_a_method_does_not_have_is_refused() -> None:
    with pytest.raises(UsageError, match="of method cut, not proposed: name that one"):
        resolve_config("proposed", settings=["method=cut"])
    with pytest.raises(UsageError, match=r"cut has no loss\.l1"):
        resolve_config("cut", settings=["loss.l1=1", "data.paired=true"])


def test_a_folder_s_run_keeps_its_own(tmp_path: Path) -> None:
    config = replace(EFFICIENT, seed=8)
    Run(config, Fabric(accelerator="cpu", devices=1), 2).save(tmp_path / CHECKPOINT)
    saved = saved_checkpoint(tmp_path)
    assert saved is not None
    assert saved.config == config
    for settings in ((), ("seed=8", "optim.ema=0.9")):
        assert resolve_config("proposed", None, (), settings, tmp_path) == config
    for method, settings, reason in (
        ("proposed", ["seed=9"], "another run: seed is 8 there, 9 here"),
        ("cut", [], 'another run: method is "proposed" there, "cut" here'),
        ("cut", ["seed=9"], 'method is "proposed" there, "cut" here; seed is 8 there, 9 here'),
    ):
        with pytest.raises(CheckpointError, match=reason):
            resolve_config(method, None, (), settings, tmp_path)
