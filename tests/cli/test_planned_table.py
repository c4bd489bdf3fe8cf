"""The comparison that docs/methods.md plans: every command of it would run, on what it says."""

import dataclasses
import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from depthcli.cli.app import main
from depthcli.training.methods.registry import default_config
from depthcli.training.methods.table import PAPER_METHODS
from depthcli.training.presets import preset_file
from depthcli.training.settings import apply_overrides, resolve_config
from docs import write_methods

PAGE = (Path(__file__).parents[2] / "docs" / "methods.md").read_text("utf-8")
MEASURED = Path(__file__).parents[2] / "docs" / "results" / "generators"


def _commands() -> list[list[str]]:
    """The words of every `depthcli train` on the page, with its variables filled in."""
    found, values = [], {}
    for block in re.findall(r"```\n(.*?)```", PAGE, re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            if named := re.fullmatch(r'(\w+)="(.*)"', line):
                values[f"${named[1]}"] = named[2]
            elif line.startswith("depthcli train"):
                found.append(shlex.split(_filled(line, values), comments=True)[2:])
    return found


def _filled(line: str, values: dict[str, str]) -> str:
    line = re.sub(r"\$\w+", lambda named: values[named[0]], line)
    return re.sub(r"=N\b", "=69", line)


def _alone(words: list[str]) -> list[list[str]]:
    """A command for each method that one names."""
    if "--methods" in words:
        place = words.index("--methods")
        names, rest = words[place + 1].split(","), words[:place] + words[place + 2 :]
    elif "--all" in words:
        names, rest = list(PAPER_METHODS), [word for word in words if word != "--all"]
    else:
        return [words]
    if "--seeds" in rest:
        place = rest.index("--seeds")
        rest = rest[:place] + rest[place + 2 :]
    return [[name, *rest] for name in names]


def test_every_command_of_the_page_is_one_that_trains(capsys: pytest.CaptureFixture[str]) -> None:
    commands = [command for words in _commands() for command in _alone(words)]
    assert {command[0] for command in commands} == set(PAPER_METHODS)
    assert len(commands) >= len(PAPER_METHODS) + 5 + 6, "the seven, the pilot, the controls"
    for command in commands:
        assert main(["train", *command, "--show-config"]) == 0, command
        shown = tomllib.loads(capsys.readouterr().out)
        assert shown["optim"]["ema"] == 0.999


def _row(command: list[str]) -> str:
    out = Path(command[command.index("--out") + 1])
    return command[0] if out.name == "table" else re.sub(r"-seed\d$", "", out.name)


@pytest.mark.parametrize("card", sorted(MEASURED.glob("*/card.json")), ids=lambda p: p.parent.name)
def test_commands_give_the_settings_of_the_measured_generators(card: Path) -> None:
    every = [command for words in _commands() for command in _alone(words)]
    of_rows = {_row(one): one for one in every if not any("pilot" in word for word in one)}
    command = of_rows[re.sub(r"-seed\d$", "", card.parent.name)]
    settings = [command[i + 1] for i, word in enumerate(command) if word == "--set"]
    config = dataclasses.asdict(resolve_config(command[0], "paper-small", settings=settings))
    measured = json.loads(card.read_text())["training"]["config"]
    for part in ("generator", "output", "data", "loss", "optim"):
        shared = config[part].keys() & measured[part].keys()
        given = json.loads(json.dumps({name: config[part][name] for name in shared}))
        assert given == {name: measured[part][name] for name in shared}


@pytest.mark.parametrize("name", PAPER_METHODS)
def test_the_table_trains_every_method_alike(name: str) -> None:
    config = apply_overrides(default_config(name), [preset_file("paper-small")], [])
    usual, optim = default_config(name), config.optim
    assert (config.data.width, config.data.height) == (128, 128)
    assert (config.generator.width, config.generator.blocks) == (16, 6)
    assert (optim.batch_size, config.precision) == (1, "32-true")
    assert (optim.learning_rate, optim.beta1, optim.beta2) == (2e-4, 0.5, 0.999)
    assert (optim.epochs_constant, optim.epochs_decay, optim.ema) == (10, 10, 0.999)
    assert [round(1 / optim.lr_factor(epoch * 866, 866)) for epoch in (0, 9, 19)] == [1, 1, 11]
    assert config.loss == usual.loss
    assert (optim.pool_size, config.data.paired) == (usual.optim.pool_size, usual.data.paired)
    assert config.data.holdout_every == 7


def test_tables_are_written_from_the_results() -> None:
    for path, tables in write_methods.tables().items():
        text = path.read_text("utf-8")
        changed = text.replace("| **`proposed`** | ", "| **`proposed`** | .9").replace(
            "−.124", "−.1"
        )
        assert write_methods.page(changed, *tables) == text != changed


def test_deviations_are_over_seeds() -> None:
    rows = [{"rmse": "1.10"}, {"rmse": "1.14"}]
    assert write_methods.cell(rows, "rmse") == "1.120 ± .028"
    assert write_methods.cell(rows[:1], "rmse") == "1.100"
